"""Rounds of the executor, which makes its list of all that may become ready anew for each: messages
are taken with few, and read here.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.task import Future
from std_srvs.srv import Trigger

#: Messages taken in one round at most: timers and services have their turn.
AT_ONCE = 100


class NextRound:
    """Awaited in a service that answers later: the executor comes back to it whenever something
    wakes it.
    """

    def __await__(self) -> Generator[None]:
        yield


async def worked_off(
    offer: Callable[[str, Any], bool], kind: str, response: Trigger.Response
) -> Trigger.Response:
    """A service's answer that the worker sets on the future that it finds in its queue as ``kind``.
    offer : queues for the worker.
    """
    done = Future()
    if not offer(kind, done):
        response.success, response.message = False, "too much waits already"
        return response
    while not done.done():
        await NextRound()
    response.success, response.message = True, str(done.result())
    return response


def take_waiting(subscription: Subscription, receive: Callable[[Any, dict[str, Any]], None]) -> int:
    """Hand over messages, with what the middleware says of them, that wait behind the one just
    taken: what comes in bursts costs one round. Returns how many.
    """
    for count in range(AT_ONCE):
        try:
            with subscription.handle:
                taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        except InvalidHandle:  # taken down meanwhile
            return count
        if taken is None:
            return count
        receive(*taken)
    return AT_ONCE


def deserialize(data: bytes, message_type: type[Any]) -> Any:
    """The message that came as ``data``; None where these bytes are none of its type. A subscriber
    to messages in place of bytes is not told of those.
    """
    try:
        return deserialize_message(data, message_type)
    except RuntimeError:  # the client library's RMWError
        return None
