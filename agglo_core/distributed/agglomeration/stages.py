"""Domains of all ranks at one point of a distributed run, coarsened or joined toward coarser levels.

A domain's number determines its rank, and domains follow rank order. Hence the part ids on a level are
consecutive on every rank.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.agglomeration.blocks_by_coordinates import rank_of_block
from agglo_core.distributed.agglomeration.domain import Domain, join_pieces
from agglo_core.distributed.communication import Ranks


@dataclass(frozen=True)
class Numbering:
    """Global part ids on a level, consecutive by domain.

    Attributes
    ----------
    first : (count + 1,) int
        First id per domain, and the part count.
    bounds : (size + 1,) int
        First id per rank, and the part count.
    """

    first: Int
    bounds: Int

    @property
    def parts(self) -> int:
        """Total part count over all ranks."""
        return int(self.first[-1])


@dataclass(frozen=True)
class Stage:
    """Domains of all ranks at one point of the run.

    Attributes
    ----------
    ranks : Ranks
    count : int
        Domain count over all ranks.
    domains : mapping of number to Domain
        Local domains.
    """

    ranks: Ranks
    count: int
    domains: Mapping[int, Domain]

    def rank_of(self, domain: Int) -> Int:
        """Return the rank of each given domain."""
        return rank_of_block(domain, self.count, self.ranks.size)

    def of_all(self, measure: Callable[[Domain], Sequence[float]]) -> list[tuple[float, ...]]:
        """Evaluate a function on each domain, and return the results of all domains on every rank."""
        with self.ranks.together():
            local_rows = {number: tuple(measure(domain)) for number, domain in self.domains.items()}
        rows = {number: row for table in self.ranks.gathered(local_rows) for number, row in table.items()}
        return [rows[number] for number in range(self.count)]

    def numbered(self, labels: Mapping[int, Int]) -> Numbering:
        """Number the parts of all domains globally, from the labels 0..k−1 in each domain of this rank."""
        own = {number: int(each.max(initial=-1)) + 1 for number, each in labels.items()}
        counts = {number: k for counted in self.ranks.gathered(own) for number, k in counted.items()}
        first = np.concatenate(([0], np.cumsum([counts[number] for number in range(self.count)])))
        owner = self.rank_of(frozen_int(np.arange(self.count)))
        return Numbering(
            frozen_int(first), frozen_int(first[np.searchsorted(owner, np.arange(self.ranks.size + 1))])
        )

    def coarsened(self, labels: Mapping[int, Int], numbering: Numbering) -> Stage:
        """Return the domains with the agglomerates ``labels`` as nodes."""
        new = self._ids_beyond(labels, numbering)
        with self.ranks.together():
            domains = {
                number: domain.coarsened(labels[number], int(numbering.first[number]), new[number])
                for number, domain in self.domains.items()
            }
        return Stage(self.ranks, self.count, domains)

    def _ids_beyond(self, labels: Mapping[int, Int], numbering: Numbering) -> dict[int, Int]:
        """Exchange the new part ids, and return them for the remote nodes of each domain's links."""
        # Send the new ids of border nodes to each neighbour domain.
        parcels: dict[int, list[tuple[int, int, Int, Int]]] = {}
        for number, domain in self.domains.items():
            for neighbour in np.unique(domain.links.domain).tolist():
                nodes = np.unique(domain.links.node[domain.links.domain == neighbour])
                new = numbering.first[number] + labels[number][nodes]
                message = (number, neighbour, domain.ids[nodes], new)
                parcels.setdefault(int(self.rank_of(frozen_int(neighbour))), []).append(message)
        arrived = self.ranks.exchanged(parcels)
        # Look up the received ids for each link.
        new_ids = {(home, neighbour): ids for batch in arrived.values() for neighbour, home, *ids in batch}
        ids_beyond = {}
        for number, domain in self.domains.items():
            to = np.empty(len(domain.links.to), np.int64)
            for neighbour in np.unique(domain.links.domain).tolist():
                rows = np.flatnonzero(domain.links.domain == neighbour)
                old, new = new_ids[number, neighbour]
                to[rows] = new[np.searchsorted(old, domain.links.to[rows])]
            ids_beyond[number] = frozen_int(to)
        return ids_beyond

    def halved(self) -> tuple[Stage, Return]:
        """Join domains in pairs with consecutive numbers, which halves their number.

        If each rank has one domain, half of the ranks remain in use.
        """
        pieces = [(number // 2, domain) for number, domain in sorted(self.domains.items())]
        return move_pieces(self.ranks, pieces, (self.count + 1) // 2, lambda numbers: numbers // 2)


@dataclass(frozen=True)
class Return:
    """Information to send node values from joined domains back to the original domains.

    Attributes
    ----------
    sent : mapping of rank to list of int
        Positions of pieces sent to each rank.
    received : mapping of rank to list of (int, (n,) int)
        Own domain and node positions for each piece received from a rank.
    """

    ranks: Ranks
    sent: Mapping[int, Sequence[int]]
    received: Mapping[int, Sequence[tuple[int, Int]]]

    def brought(self, values: Mapping[int, Int]) -> list[Int]:
        """Return ``values`` on the joined domains to the nodes of the original domains, in the order sent."""
        parcels = {
            rank: [values[number][place] for number, place in pieces]
            for rank, pieces in self.received.items()
        }
        arrived = self.ranks.exchanged(parcels)
        pairs = [
            (place, array)
            for rank, arrays in arrived.items()
            for place, array in zip(self.sent[rank], arrays, strict=True)
        ]
        return [array for _, array in sorted(pairs, key=lambda pair: pair[0])]


def move_pieces(
    ranks: Ranks, pieces: Sequence[tuple[int, Domain]], count: int, renumbered: Callable[[Int], Int]
) -> tuple[Stage, Return]:
    """Send each domain to the rank of its new number, and join domains with equal number into one.

    Parameters
    ----------
    ranks : Ranks
    pieces : sequence of (int, Domain)
        Local pieces with their new domain numbers. Each domain gets at least one piece, from any rank.
    count : int
        Domain count over all ranks.
    renumbered : callable
        Map from old to new domain numbers in links.
    """
    # Pack the pieces by destination rank.
    sent_places: dict[int, list[int]] = {}
    for place, (number, _) in enumerate(pieces):
        sent_places.setdefault(int(rank_of_block(frozen_int(number), count, ranks.size)), []).append(place)
    with ranks.together():
        parcels = {
            rank: [(pieces[place][0], pieces[place][1].to_send()) for place in places]
            for rank, places in sent_places.items()
        }
    arrived = ranks.exchanged(parcels)
    # Join the received pieces per domain.
    pieces_of: dict[int, list[Domain]] = {}
    for number, piece in (item for parcel in arrived.values() for item in parcel):
        pieces_of.setdefault(number, []).append(piece)
    with ranks.together():
        results = {
            number: join_pieces(item, number, renumbered) for number, item in sorted(pieces_of.items())
        }
    # Remember the origin of each piece for the way back.
    iterators = {number: iter(places) for number, (_, places) in results.items()}
    received = {
        rank: [(number, next(iterators[number])) for number, _ in parcel] for rank, parcel in arrived.items()
    }
    stage = Stage(ranks, count, {number: domain for number, (domain, _) in results.items()})
    return stage, Return(ranks, sent_places, received)
