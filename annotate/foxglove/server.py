"""Stream of labelled frames over Foxglove's WebSocket protocol."""

from types import TracebackType
from typing import Self

import foxglove
from mcap_protobuf.schema import build_file_descriptor_set

from annotate.foxglove.origin_gate import LOOPBACK, OriginGate, hidden_address
from annotate.foxglove.topics import SCHEMAS, Shown, shown_messages
from sensors.errors import CloudError, Setting
from sensors.session.messages import EVENTS, event_message

PORT = 8765  # default of Foxglove's app
BACKLOG = 3 * len(SCHEMAS)  # messages kept for a slow client, three frames; untuned


class FoxgloveServer:
    """Server of every topic of ``topics.SCHEMAS``; a context manager.

    Only programs of this machine and Foxglove's app are admitted (``origin_gate``), because the stream shows
    a person and the protocol has no password. port: 0 takes a free one. behind: address and port of the SDK's
    own server. Raises CloudError for a taken or forbidden port.
    """

    def __init__(self, port: int = PORT) -> None:
        # Without a reference here the context and its channels are destroyed.
        self._context = context = foxglove.Context()
        self._channels = {
            topic: foxglove.Channel(
                topic,
                schema=foxglove.Schema(
                    name=schema.DESCRIPTOR.full_name,
                    encoding="protobuf",
                    data=build_file_descriptor_set(schema).SerializeToString(),
                ),
                message_encoding="protobuf",
                context=context,
            )
            for topic, schema in SCHEMAS.items()
        }
        hidden = hidden_address()
        self._server = foxglove.start_server(
            name="annotate-cloud", host=hidden, port=0, context=context, message_backlog_size=BACKLOG
        )
        try:
            self.behind = (hidden, self._server.port)
            self._gate = OriginGate(port, self.behind)
        except (OSError, OverflowError) as error:
            self._server.stop()
            why = getattr(error, "strerror", None) or error
            raise CloudError(
                f"port {port} cannot be served ({why}); choose another port", Setting.PORT
            ) from error
        self.port = self._gate.port

    def __enter__(self) -> Self:
        self._gate.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._gate.__exit__()
        self._server.stop()

    @property
    def address(self) -> str:
        """Return the URL for clients."""
        return f"ws://{LOOPBACK}:{self.port}"

    def show(self, shown: Shown) -> None:
        """Send a frame on the subscribed topics, without waiting for a client.

        Raises FormatError for a colour image that is neither JPEG nor PNG.
        """
        for topic, stamp_ns, message in shown_messages(
            shown, lambda topic: self._channels[topic].has_sinks()
        ):
            self._channels[topic].log(message.SerializeToString(), log_time=stamp_ns)

    @property
    def has_event_listeners(self) -> bool:
        """Return True if a client has subscribed to events."""
        return self._channels[EVENTS].has_sinks()

    def send_event(self, stamp_ns: int, text: str) -> None:
        """Send an event between frames. stamp_ns: since 1970, on the host's clock."""
        self._channels[EVENTS].log(event_message(stamp_ns, text).SerializeToString(), log_time=stamp_ns)
