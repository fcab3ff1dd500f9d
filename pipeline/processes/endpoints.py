"""Where each process of a graph listens, whom it looks for, and whose clock it follows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.graph.graph import Graph
from pipeline.graph.placing import numbered
from pipeline.scheduling.partition import links_between

#: Of a link to another host: what the kernel holds back of it is old by the time it is sent. The
#: kernel doubles it: 0.26 s of a link of 8 Mbit/s, and 100 Mbit/s over one that takes 20 ms.
_SHORT = {f"transport/link/{kind}/so_sndbuf": 128 << 10 for kind in ("tcp", "tls")}


def host_of_clock(graph: Graph) -> str:
    """The host whose clock the graph's is: that of the first source in the file."""
    placement = graph.placement
    first = next(node.name for node in graph.topology.stages if node.is_source)
    return placement.host_of[placement.process_of[first]]


def ends_of(
    graph: Graph, name: str, here: Sequence[str], endpoints: Mapping[str, str]
) -> dict[str, Any]:
    """How process `name` meets the others, as JSON values.

    `here` are the processes of this host with their loopback `endpoints`. Of two processes the
    later in the file looks for the earlier; between hosts, the one that does not listen, or is
    later, looks for the other.
    """
    placement, order, hosts = graph.placement, list(graph.processes), list(graph.hosts)
    own = graph.hosts[placement.host_of[name]]
    listen, connect = [endpoints[name]], []
    abroad = _abroad(graph, own.name)
    if name in abroad:
        listen += numbered(own.listen, abroad.index(name))
    peers = sorted(_peers(graph, name), key=order.index)
    for peer in peers:
        host = graph.hosts[placement.host_of[peer]]
        if peer in here:
            connect += [endpoints[peer]] if order.index(peer) < order.index(name) else []
        elif not own.listen or (host.listen and hosts.index(host.name) < hosts.index(own.name)):
            connect += numbered(host.reach, _abroad(graph, host.name).index(peer))
    clock = host_of_clock(graph)
    tellers = [peer for peer in peers if placement.host_of[peer] == clock]
    return {
        "listen": listen,
        "connect": connect,
        "zenoh": {**(_SHORT if name in abroad else {}), **own.zenoh},
        "tells_clock": own.name == clock and name in abroad,
        "follows": tellers[0] if own.name != clock and tellers else None,
    }


def _peers(graph: Graph, name: str) -> set[str]:
    """The processes that share a link with this one."""
    found: set[str] = set()
    for link in links_between(graph.topology, graph.placement):
        if link.origin == name:
            found |= set(link.targets)
        elif name in link.targets:
            found.add(link.origin)
    return found


def _abroad(graph: Graph, host: str) -> list[str]:
    """The processes of a host that have links to another one, in the order of the file."""
    placement = graph.placement
    found: set[str] = set()
    for link in links_between(graph.topology, placement):
        if not link.local:
            found |= {link.origin, *link.targets}
    return [name for name in graph.processes if name in found and placement.host_of[name] == host]
