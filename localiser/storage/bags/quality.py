"""The quality of service that a bag states of topics whose last message is kept for late subscribers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosbags.interfaces import Qos


def latched_quality() -> Qos:
    """Return that of a topic that is reliable and transient local, and keeps one message."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    keep, reliable, latched = QosHistory.KEEP_LAST, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    never = QosTime(9_223_372_036, 854_775_807)  # what ROS 2 writes for a duration without end
    return Qos(keep, 1, reliable, latched, never, never, QosLiveliness.AUTOMATIC, never, False)
