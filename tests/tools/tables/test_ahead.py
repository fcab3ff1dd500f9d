"""Which networks of a table may be trained at once."""

from __future__ import annotations

import pytest

pytest.importorskip("torch", reason="training needs the extra 'train'")

from tools.tables.ahead import Trained, rounds
from tools.tables.networks import needs
from tools.tables.plan import plans


@pytest.mark.parametrize("there", [[], [("source", 0), ("views-map", 1), ("views", 0)]])
def test_a_network_is_trained_once_and_after_those_that_it_needs(there: list[Trained]) -> None:
    for table in plans().tables.values():
        wanted = {(row.network, seed) for row in table.rows.values() for seed in range(2)}
        wanted = {one for one in wanted if one[0] is not None}
        done = set(there)
        seen: list[Trained] = []
        for together in rounds(sorted(wanted), there):
            for name, seed in together:
                assert (name, seed) in there or {(n, seed) for n in needs(name)} <= done
            done |= set(together)
            seen += together
        assert len(seen) == len(set(seen))
        assert wanted <= set(seen)
        assert all(one in wanted for one in seen if one in there)


def test_the_fused_labels_need_the_network_that_is_in_them() -> None:
    assert needs("source") == set()
    assert needs("views-fused") == {"source"}
    assert needs("again") == {"source", "views-map"}
