"""What stands in a recording beside the messages: its attachments and definitions of types."""

from __future__ import annotations

from pathlib import Path

from ..recording.encoding import METADATA_RECORD
from ..recording.errors import UnreadableRecording
from ..recording.mcap_content import Content, read_content
from ..recording.mcap_records import DamagedRecord
from ..recording.reader import read_bytes
from ..recording.schemas import load_definition
from ..recording.strategy_file import STRATEGY_FILE
from ..recording.types import TYPES


def file_faults(path: Path) -> list[str]:
    """Check that a file has one strategy, no other attachment, and the definitions of ROS.

    Raises:
        UnreadableRecording: The file is not a whole recording.
        RecordingFailed: The interfaces of a type are not installed.
    """
    try:
        content = read_content(read_bytes(path))
    except DamagedRecord as error:
        raise UnreadableRecording(path, str(error)) from error
    faults = []
    if [each.name for each in content.attachments] != [STRATEGY_FILE]:
        faults.append(
            f'attachments: there are {len(content.attachments)}, not {STRATEGY_FILE} alone'
        )
    if [each.name for each in content.metadata] != [METADATA_RECORD]:
        faults.append(f'metadata: there are records beside {METADATA_RECORD}')
    return [*faults, *_definition_faults(content)]


def _definition_faults(content: Content) -> list[str]:
    """Compare with the interfaces that are installed; others than the planner's are not known."""
    used = {message.channel_id for message in content.messages}
    wrong = set()
    for channel in (content.channels[k] for k in sorted(used)):
        schema = content.schemas[channel.schema_id]
        if schema.name not in TYPES:
            continue
        known = load_definition(schema.name)
        stated = schema.encoding, schema.data, channel.metadata.get('topic_type_hash')
        if stated != (known.encoding, known.text.encode(), known.type_hash):
            wrong.add(schema.name)
    return [f'definition of {name}: it is not that of the installed one' for name in sorted(wrong)]
