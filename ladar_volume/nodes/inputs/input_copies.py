"""A copy of an input message as it travels from the node that uses it to the log: its bytes, with a
line of JSON that says what they are.
"""

from __future__ import annotations

import array
import json
from dataclasses import dataclass
from typing import TypeAlias

from std_msgs.msg import MultiArrayDimension, MultiArrayLayout, UInt8MultiArray

#: When the publisher sent a message (ns), and its number there: which one it is, for all listeners.
Key: TypeAlias = tuple[int, int]
#: What a copy begins: nothing; all that is heard of a publisher; all that is heard of a topic.
BEGINS = ("", "publisher", "topic")


@dataclass(frozen=True)
class InputCopy:
    """topic : its full name · kind : its type, as ``sensor_msgs/msg/Imu`` · data : the message as
    it came · published_ns, sequence : as the middleware says · received_ns : by the clock of the
    node that used it · begins : one of :data:`BEGINS`.
    """

    topic: str
    kind: str
    data: bytes
    published_ns: int
    sequence: int
    received_ns: int
    begins: str = ""

    @property
    def key(self) -> Key:
        """Which message it is."""
        return self.published_ns, self.sequence

    def message(self) -> UInt8MultiArray:
        """It, ready to be published."""
        fields = ("topic", "kind", "published_ns", "sequence", "received_ns", "begins")
        label = json.dumps({name: getattr(self, name) for name in fields})
        size = len(self.data)
        dim = [MultiArrayDimension(label=label, size=size, stride=size)]
        layout = MultiArrayLayout(dim=dim, data_offset=0)
        return UInt8MultiArray(layout=layout, data=array.array("B", self.data))


def copy_from_message(message: UInt8MultiArray) -> InputCopy | None:
    """The copy in a message; None for a message that holds none."""
    try:
        (dim,) = message.layout.dim
        fields = json.loads(dim.label)
        copy = InputCopy(
            topic=str(fields["topic"]),
            kind=str(fields["kind"]),
            data=bytes(message.data),
            published_ns=int(fields["published_ns"]),
            sequence=int(fields["sequence"]),
            received_ns=int(fields["received_ns"]),
            begins=str(fields["begins"]),
        )
    except (ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None
    whole = dim.size == len(copy.data) and copy.topic.startswith("/") and copy.begins in BEGINS
    return copy if whole and copy.published_ns > 0 and copy.sequence > 0 else None
