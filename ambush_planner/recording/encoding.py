"""A departure as the bytes of one MCAP file of the profile ``ros2``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO

from mcap.writer import CompressionType, Writer

from .mcap_content import Content
from .messages import Attachment, RecordedMessage
from .qos import qos_to_yaml
from .schemas import load_definition

METADATA_RECORD = 'ambush_planner'
# Of the metadata record: what its entries mean.
FORMAT = '2'


def encode_departure(
    messages: Sequence[RecordedMessage],
    metadata: Mapping[str, str],
    attachments: Sequence[Attachment],
    compression: CompressionType,
) -> bytes:
    """Return the whole file; the messages are put in the order of time.

    Metadata and attachments come first: what is cut off at the end costs the outputs that can
    be computed again before it costs what they were computed from.

    Raises:
        RecordingFailed: A message's definition is not installed.
    """
    ordered = sorted(messages, key=lambda recorded: recorded.stamp_ns)
    stream = BytesIO()
    # The checksum over the data section covers the metadata record; those of chunks do not.
    writer = Writer(stream, compression=compression, enable_data_crcs=True)
    writer.start(profile='ros2')
    writer.add_metadata(METADATA_RECORD, dict(metadata))
    for file in attachments:
        writer.add_attachment(0, ordered[0].stamp_ns, file.name, file.media_type, file.data)
    channels = _Channels(writer)
    for recorded in ordered:
        time = recorded.stamp_ns
        writer.add_message(channels.of(recorded), time, recorded.data, publish_time=time)
    writer.finish()
    return stream.getvalue()


def encode_content(content: Content) -> bytes:
    """Return a whole file (zstd) with what another one held, in its order.

    Args:
        content: Every message's channel and schema must be there.
    """
    stream = BytesIO()
    writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
    writer.start(profile=content.profile or 'ros2')
    for each in content.metadata:
        writer.add_metadata(each.name, each.metadata)
    for file in content.attachments:
        writer.add_attachment(
            file.create_time, file.log_time, file.name, file.media_type, file.data
        )
    schemas = {
        key: writer.register_schema(schema.name, schema.encoding, schema.data)
        for key, schema in content.schemas.items()
    }
    channels = {
        key: writer.register_channel(
            channel.topic, channel.message_encoding, schemas[channel.schema_id], channel.metadata
        )
        for key, channel in content.channels.items()
        if channel.schema_id in schemas
    }
    for message in content.messages:
        writer.add_message(
            channels[message.channel_id],
            message.log_time,
            message.data,
            message.publish_time,
            message.sequence,
        )
    writer.finish()
    return stream.getvalue()


class _Channels:
    """Registers each schema and each channel with the writer once."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str, str], int] = {}

    def of(self, recorded: RecordedMessage) -> int:
        """Return the channel's id for a message, after registering what is new."""
        key = (recorded.topic, recorded.type, qos_to_yaml(recorded.qos))
        if key not in self._channels:
            self._channels[key] = self._register(*key)
        return self._channels[key]

    def _register(self, topic: str, type_: str, qos: str) -> int:
        definition = load_definition(type_)
        if type_ not in self._schemas:
            self._schemas[type_] = self._writer.register_schema(
                type_, definition.encoding, definition.text.encode()
            )
        metadata = {'offered_qos_profiles': qos, 'topic_type_hash': definition.type_hash}
        return self._writer.register_channel(topic, 'cdr', self._schemas[type_], metadata)
