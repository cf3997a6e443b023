"""metadata.yaml: written from cached pieces, yet the document that a YAML library writes."""

from collections import Counter

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_samples import LATCHED, VOLATILE
from steps import steps

from ambush_planner.recording.bag_metadata import (
    BagFile,
    BagMetadata,
    RecordedTopic,
    listed_files,
)
from ambush_planner.recording.qos import qos_to_yaml
from ambush_planner.recording.yaml_text import BadYaml, load_yaml

TOPICS = [
    RecordedTopic('/path', 'nav_msgs/msg/Path', qos_to_yaml(LATCHED), 'RIHS01_1'),
    RecordedTopic('/path', 'nav_msgs/msg/Path', qos_to_yaml(VOLATILE), 'RIHS01_1'),
    RecordedTopic('/a: "b"', 'x/msg/Y', '', ''),
    RecordedTopic('- no', "it's/msg/Y", '[', 'null'),
]
NAMES = st.text(st.characters(exclude_categories=('Cs', 'Cc'), exclude_characters='/\x7f'),
                min_size=1)
FILES = st.builds(
    lambda name, start, length, counts: BagFile(name, start, start + length, counts),
    NAMES,
    st.integers(0, 2**62),
    st.integers(0, 2**60),
    st.dictionaries(st.sampled_from(TOPICS), st.integers(1, 9), min_size=1),
)


def profiles(topic):
    return [] if topic.qos in ('', '[') else yaml.safe_load(topic.qos)


def span(files):
    start = min(file.start_ns for file in files)
    return {
        'starting_time': {'nanoseconds_since_epoch': start},
        'duration': {'nanoseconds': max(file.end_ns for file in files) - start},
    }


def plain_document(files):
    """The document as one would write it down, whole."""
    counts = sum((Counter(file.message_counts) for file in files), Counter())
    return {
        'rosbag2_bagfile_information': {
            'version': 9,
            'storage_identifier': 'mcap',
            **span(files),
            'message_count': counts.total(),
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': topic.name,
                        'type': topic.type,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': profiles(topic),
                        'type_description_hash': topic.type_hash,
                    },
                    'message_count': count,
                }
                for topic, count in counts.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [file.name for file in files],
            'files': [
                {'path': file.name, **span([file]), 'message_count': sum(
                    file.message_counts.values())}
                for file in files
            ],
            'custom_data': {},
            'ros_distro': 'jazzy',
        }
    }


@settings(max_examples=80, deadline=None)
@given(files=st.lists(FILES, min_size=1, max_size=6, unique_by=lambda file: file.name),
       keep=st.sets(st.integers(0, 5)))
def test_the_text_is_that_of_the_whole_document(files, keep):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('ROS_DISTRO', 'jazzy')
        metadata = BagMetadata(files)
        document = plain_document(files)
        assert yaml.safe_load(metadata.text()) == document
        assert yaml.safe_load(metadata.text()) == yaml.safe_load(yaml.safe_dump(document))
        assert listed_files(metadata.text()) == [file.name for file in files]
        kept = [file for number, file in enumerate(files) if number in keep]
        metadata.keep([file.name for file in kept] + ['other'])
        assert metadata.is_empty() == (not kept)
        if kept:
            assert yaml.safe_load(metadata.text()) == plain_document(kept)


def test_a_file_without_messages_does_not_move_the_start():
    files = [BagFile('a', 50, 60, {TOPICS[0]: 1}), BagFile('b', 0, 0, {})]
    information = yaml.safe_load(BagMetadata(files).text())['rosbag2_bagfile_information']
    assert information['starting_time'] == {'nanoseconds_since_epoch': 50}
    assert information['duration'] == {'nanoseconds': 10}
    empty = yaml.safe_load(BagMetadata(files[1:]).text())['rosbag2_bagfile_information']
    assert empty['topics_with_message_count'] == []
    assert empty['message_count'] == 0


def test_one_more_file_among_thousands_is_cheap():
    files = [BagFile(f'run_{n}.mcap', n, n + 1, {TOPICS[0]: 1, TOPICS[1]: 2}) for n in range(5001)]
    metadata = BagMetadata(files[:-1])
    names = [file.name for file in files]

    def one_more():
        metadata.keep(names)
        metadata.add(files[-1])
        return metadata.text()

    # A YAML library takes some 10 000 000.
    assert steps(one_more) < 100_000


@pytest.mark.parametrize(
    'text',
    [b'', b'[', b'\xff', b'x: 1', b'3', b'rosbag2_bagfile_information: []', b'[' * 100_000,
     b'- ' * 100_000, b'rosbag2_bagfile_information: {relative_file_paths: 3}',
     b'rosbag2_bagfile_information: {relative_file_paths: [[1]]}', b'!!timestamp x', b'a: *b'],
)
def test_text_that_is_no_metadata(text):
    with pytest.raises(BadYaml):
        listed_files(text)


def test_yaml_that_is_wide_or_deep():
    numbers = list(range(20_000))
    assert load_yaml(str(numbers)) == numbers
    assert load_yaml('[' * 100 + ']' * 100)
    for deep in ('[' * 2000 + ']' * 2000, '{a: ' * 100_000, '- ' * 100_000):
        with pytest.raises(BadYaml):
            load_yaml(deep)
