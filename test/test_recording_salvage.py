"""What is saved of a broken file: all but what the fault itself touches."""

import random
from dataclasses import replace
from io import BytesIO

import pytest
from mcap.reader import make_reader
from recording_samples import METADATA, STRATEGY, small_departure

from ambush_planner.recording.encoding import encode_departure
from ambush_planner.recording.recorder import COMPRESSIONS
from ambush_planner.recording.salvage import salvage

SENT = small_departure()


def encoded(compression='zstd'):
    return encode_departure(SENT, METADATA, [STRATEGY], COMPRESSIONS[compression])


def chunk_range(data):
    """Where the only chunk lies."""
    (index,) = make_reader(BytesIO(data)).get_summary().chunk_indexes
    return index.chunk_start_offset, index.chunk_start_offset + index.chunk_length


def test_a_broken_header_among_the_records_of_a_chunk_costs_one_message():
    data = bytearray(encoded('none'))
    header = data.index(SENT[1].data) - 22 - 9
    for byte in (0, 1, 2, 3, 5, 8):
        changed = bytearray(data)
        changed[header + byte] ^= 64
        found = salvage(bytes(changed))
        kept = {message.data for message in found.content.messages}
        assert {SENT[0].data, SENT[2].data, SENT[3].data} <= kept
        assert found.unverified == len(kept)
        assert found.losses


@pytest.mark.parametrize('byte', range(9))
def test_a_broken_header_of_a_chunk_costs_no_message(byte):
    for compression in COMPRESSIONS:
        data = bytearray(encoded(compression))
        data[chunk_range(bytes(data))[0] + byte] ^= 16
        found = salvage(bytes(data))
        assert [message.data for message in found.content.messages] == [m.data for m in SENT]
        assert found.losses


def test_a_large_compressed_chunk_is_unpacked_up_to_the_cut():
    for compression in ('zstd', 'lz4'):
        noise = random.Random(3).randbytes(600_000)
        sent = [*SENT[:3], replace(SENT[3], data=SENT[3].data + noise)]
        data = encode_departure(sent, METADATA, [], COMPRESSIONS[compression])
        found = salvage(data[: len(data) // 2])
        assert [m.data for m in found.content.messages] == [m.data for m in SENT[:3]]


def test_a_broken_attachment_or_metadata_record_costs_nothing_else():
    for place, lost in ((encoded().index(STRATEGY.data) + 3, 'attachments'),
                        (encoded().index(b'ambush_planner') - 4, 'metadata')):
        data = bytearray(encoded())
        data[place] ^= 64
        content = salvage(bytes(data)).content
        assert len(content.messages) == 4
        assert (len(content.metadata), len(content.attachments)) == (
            lost != 'metadata', lost != 'attachments')


def test_a_changed_metadata_record_is_noticed_by_the_checksum_over_all():
    data = encoded().replace(METADATA['input_sha256'].encode(), b'cd' * 32)
    (loss,) = salvage(data).losses
    assert 'a metadata record may be wrong' in loss.reason
