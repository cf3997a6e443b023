"""What a forger may do around the content of a departure: to the file and its indexes."""

from forging import NEW_ROUTE
from two_faced import early_message_index, hidden_chunk, renamed_topics


def disguise(how):
    """Bytes in which some readers find another departure."""
    return lambda forger, rng: setattr(forger, 'disguise', how)


AROUND = [
    (NEW_ROUTE, disguise(hidden_chunk), False, 'a record of kind 128'),
    (NEW_ROUTE, disguise(renamed_topics), False, 'the summary is of another content'),
    (NEW_ROUTE, disguise(early_message_index), False, 'a message index that is not'),
]
