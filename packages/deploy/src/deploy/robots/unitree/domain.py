"""The DDS domain of a robot, on one network interface."""

# pyright: reportMissingImports=false
from __future__ import annotations

from functools import cache
from xml.sax.saxutils import quoteattr

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.qos import Policy, Qos

from deploy.errors import RobotError

NEWEST = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(1))
"""For a reader that wants the newest message, from reliable writers and others."""

NEWEST_OF_OTHERS = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(1), Policy.IgnoreLocal.Participant)
"""The same, blind to writers of its own participant."""

_LOOPBACK = """<AllowMulticast>false</AllowMulticast>"""
_LOOPBACK_PEERS = """<Discovery><ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>50\
</MaxAutoParticipantIndex><Peers><Peer Address="127.0.0.1"/></Peers></Discovery>"""


def configuration(interface: str) -> str:
    """Cyclone DDS configuration (XML) that uses one network interface; `lo` needs no multicast."""
    local = interface == "lo"
    return (
        f'<CycloneDDS><Domain Id="any"><General>{_LOOPBACK if local else ""}<Interfaces>'
        f"<NetworkInterface name={quoteattr(interface)}/></Interfaces></General>"
        f"{_LOOPBACK_PEERS if local else ''}</Domain></CycloneDDS>"
    )


def join(domain_id: int, interface: str) -> DomainParticipant:
    """A participant of its own in a domain.

    Raises:
        RobotError: There is no such interface.
    """
    try:
        _domain(domain_id, interface)
        return DomainParticipant(domain_id)
    except DDSException as error:
        raise RobotError(
            f"DDS domain {domain_id} cannot be opened on network interface {interface!r} ({error}); "
            "`ip address` lists the interfaces: name the one that the robot is wired to"
        ) from error


@cache  # a process configures a domain once, before its first participant
def _domain(domain_id: int, interface: str) -> Domain:
    return Domain(domain_id, configuration(interface))
