"""Taking messages with few rounds of the executor, which makes its list of all that may become ready anew for each; and reading them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.serialization import deserialize_message

#: Messages taken in one round at most: timers and services have their turn.
AT_ONCE = 100


def waiting(subscription: Any) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Messages, with what the middleware says of them, that wait behind the one just taken: what comes in bursts costs one round."""
    for _ in range(AT_ONCE):
        try:
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        except InvalidHandle:  # taken down meanwhile
            return
        if taken is None:
            return
        yield taken


def unpacked(data: bytes, message_type: Any) -> Any:
    """The message that came as ``data``; None where these bytes are none of its type. A subscriber to messages in place of bytes is not
    told of those."""
    try:
        return deserialize_message(data, message_type)
    except RuntimeError:  # the client library's RMWError
        return None
