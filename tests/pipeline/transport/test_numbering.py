"""Numbers: what is lost is counted once, what was seen is refused."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import WireError
from pipeline.transport.numbering import SILENCE_NS, Numbering


def test_messages_in_order_lose_nothing() -> None:
    numbering = Numbering()
    assert [numbering.message(1, number, 0) for number in range(5)] == [0] * 5
    assert (numbering.lost, numbering.missed_before) == (0, 0)


def test_a_gap_is_lost() -> None:
    numbering = Numbering()
    numbering.message(1, 0, 0)
    assert numbering.message(1, 4, 0) == 3
    assert numbering.lost == 3


def test_news_tell_that_the_last_messages_are_lost_and_tell_it_once() -> None:
    numbering = Numbering()
    numbering.message(1, 0, 0)
    assert numbering.news(1, 3, 0) == 2
    assert numbering.news(1, 3, 0) == 0
    assert numbering.message(1, 3, 0) == 0


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_number_that_was_seen_or_passed_is_refused(number: int) -> None:
    numbering = Numbering()
    numbering.message(1, 0, 0)
    numbering.message(1, 2, 0)
    with pytest.raises(WireError, match="again") as refusal:
        numbering.message(1, number, 0)
    assert refusal.value.reason == "replayed"
    assert numbering.message(1, 3, 0) == 0


def test_what_was_sent_before_we_came_is_missed_and_not_lost() -> None:
    numbering = Numbering()
    assert numbering.message(1, 100, 0) == 0
    assert (numbering.lost, numbering.missed_before) == (0, 100)


def test_a_publisher_that_was_started_anew_counts_from_zero_and_what_it_sent_unheard_is_lost() -> (
    None
):
    numbering = Numbering()
    numbering.message(1, 50, 0)
    assert numbering.message(2, 2, 0) == 2
    assert numbering.message(2, 3, 0) == 0


def test_an_earlier_life_is_refused_while_the_later_one_is_heard() -> None:
    numbering = Numbering()
    numbering.message(7, 0, 0)
    with pytest.raises(WireError, match="epoch 6") as refusal:
        numbering.message(6, 1, SILENCE_NS - 1)
    assert refusal.value.reason == "stale"


def test_a_publisher_whose_clock_fell_back_is_believed_after_a_silence() -> None:
    numbering = Numbering()
    numbering.message(7, 0, 0)
    assert numbering.message(6, 0, SILENCE_NS) == 0
    with pytest.raises(WireError, match="again"):
        numbering.message(6, 0, SILENCE_NS)


@given(kept=st.sets(st.integers(0, 40), min_size=1), told=st.integers(0, 41))
def test_received_and_lost_add_up_to_what_was_published(kept: set[int], told: int) -> None:
    numbering = Numbering()
    numbering.news(1, 0, 0)
    received = 0
    for number in sorted(kept):
        numbering.message(1, number, 0)
        received += 1
    published = max(told, max(kept) + 1)
    numbering.news(1, published, 0)
    assert received + numbering.lost == published
