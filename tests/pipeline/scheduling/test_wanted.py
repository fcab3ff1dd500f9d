"""Wanted frames: predictions from stamps, against a search over all of them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pipeline.scheduling.topology import Sync
from pipeline.scheduling.wanted import AHEAD, MustWish, Need, Rhythm, Verdict, Wishes


def rhythm(*stamps: int, arrives: int = 0) -> Rhythm:
    made = Rhythm()
    for stamp in stamps:
        made.add(stamp, stamp + arrives)
    return made


def even(period: int, phase: int = 0, count: int = 9) -> Rhythm:
    return rhythm(*range(phase, phase + count * period, period))


def test_a_period_is_known_after_four_even_gaps() -> None:
    made = Rhythm()
    regular = []
    for stamp in range(0, 60, 10):
        made.add(stamp, stamp)
        regular.append(made.regular)
    assert regular == [False] * 4 + [True] * 2
    assert made.period == 10


def test_one_lost_message_does_not_spoil_the_rhythm_and_disorder_does() -> None:
    assert rhythm(0, 10, 20, 40, 50, 60).regular
    assert not rhythm(0, 3, 20, 21, 40, 41, 60, 90).regular


def test_a_prediction_ends_three_periods_after_the_last_message() -> None:
    trigger = even(100)
    assert trigger.holds(800 + 300)
    assert not trigger.holds(800 + 301)


steps = st.integers(1, 40)


@given(
    period=steps,
    phase=st.integers(0, 40),
    frame=st.integers(0, 900),
    gap=steps,
    own=steps,
    tolerance=st.integers(0, 30),
    offset=st.integers(-20, 20),
    sync=st.sampled_from([Sync.NEAREST, Sync.LATEST, Sync.EXACT]),
)
def test_a_wish_is_met_as_a_search_over_all_instants_says(
    period: int, phase: int, frame: int, gap: int, own: int, tolerance: int, offset: int, sync: Sync
) -> None:
    trigger = even(period, phase)
    last = phase + 8 * period
    instants = [last - n * period for n in range(8)] + [last + n * period for n in range(1, 1000)]
    shifted = frame + offset
    expected = {
        Sync.NEAREST: any(
            abs(t - shifted) <= tolerance and -gap < 2 * (t - shifted) <= own for t in instants
        ),
        Sync.LATEST: any(shifted <= t < shifted + own for t in instants),
        Sync.EXACT: shifted in instants,
    }[sync]
    assert MustWish(trigger, sync, tolerance, offset).meets(frame, gap, own) == expected


@given(camera=st.integers(5, 60), trigger=st.integers(5, 200), phase=st.integers(0, 200))
def test_of_even_streams_each_trigger_wants_one_frame_and_it_is_the_nearest(
    camera: int, trigger: int, phase: int
) -> None:
    """Frames are judged as they come, before the triggers that want them."""
    root, frames = Rhythm(), Rhythm()
    wishes = Wishes([MustWish(root, Sync.NEAREST, 10_000, 0)])
    triggers = [phase + n * trigger for n in range(1, 40)]
    stamps = range(0, triggers[-1], camera)
    musts = []
    for stamp in stamps:
        while triggers and triggers[0] < stamp:
            root.add(triggers.pop(0), stamp)
        frames.add(stamp, stamp)
        if root.stamps and wishes.verdict(frames) is Verdict.MUST:
            musts.append(stamp)
    first = next((stamp for stamp in stamps if stamp > phase + 10 * trigger + 10 * camera), None)
    if first is None:
        return
    all_triggers = [phase + n * trigger for n in range(1, 40)]
    nearest = {min(stamps, key=lambda s: (abs(s - t), s)) for t in all_triggers}
    judged = range(first, stamps[-1])  # the last frame has no successor to be nearer
    assert {m for m in musts if m in judged} == {n for n in nearest if n in judged}


@given(jitter=st.lists(st.integers(-3, 3), min_size=40, max_size=40), instant=st.integers(300, 700))
def test_of_uneven_frames_one_and_only_one_is_wanted_for_an_instant(
    jitter: list[int], instant: int
) -> None:
    wishes = Wishes(
        [MustWish(rhythm(*range(instant - 800, instant + 1, 100)), Sync.NEAREST, 50, 0)]
    )
    frames, musts = Rhythm(), []
    for number, shift in enumerate(jitter):
        stamp = 20 * number + shift
        frames.add(stamp, stamp)
        verdict = wishes.verdict(frames) if number > 5 else Verdict.NO
        if verdict is Verdict.MUST and abs(stamp - instant) < 50:
            musts.append(stamp)
    assert len(musts) == 1
    assert abs(musts[0] - instant) <= 10 + 3 + 3


def test_without_a_rhythm_every_frame_is_run() -> None:
    wish = MustWish(rhythm(0, 3, 50, 51), Sync.NEAREST, 10, 0)
    assert Wishes([wish]).verdict(even(10)) is Verdict.EVERY
    assert Wishes([MustWish(even(10), Sync.NEAREST, 1, 0)]).verdict(rhythm(0, 9)) is Verdict.EVERY


def test_a_frame_that_nobody_must_have_is_run_only_for_somebody_who_takes_any() -> None:
    wish = MustWish(even(100, 5), Sync.NEAREST, 2, 0)  # 5, 105 ... 805, 905
    frames = even(10, 0, 84)  # the last one at 830
    assert Wishes([wish]).verdict(frames) is Verdict.NO
    assert Wishes([wish], may=True).verdict(frames) is Verdict.MAY
    assert Wishes([wish], all=True).verdict(frames) is Verdict.MUST


def test_a_set_that_will_be_skipped_wants_no_frame() -> None:
    thermal = Need(even(110), tolerance=50, offset=0)  # 0, 110 ... 880, 990, 1100, 1210
    # Within 50 of one that came or will; between two; before all that is known of; too far ahead.
    for instant, unmet in ((930, False), (931, True), (939, True), (940, False)):
        assert thermal.unmet(instant) is unmet
    assert thermal.unmet(880 + 55)
    assert not thermal.unmet(50 + 1)  # the last eight begin at 110
    assert not thermal.unmet(880 + 330 + 55)
    wish = MustWish(even(935), Sync.NEAREST, 50, 0, (thermal,))
    assert not wish.meets(935, 10, 10)
    assert wish.meets(1870, 10, 10)  # of which nothing is foreseen


def test_a_stream_that_wobbles_is_taken_to_reach_farther() -> None:
    stamps = [0, 112, 220, 330, 440, 550, 660, 770, 880]  # gaps of 108 to 112
    assert not Need(rhythm(*stamps), 50, 0).unmet(931 + 3)
    assert Need(rhythm(*stamps), 50, 0).unmet(931 + 4)
    assert Need(rhythm(*stamps), 50, 7).unmet(931 + 4 + 7)
    lost = [stamp for stamp in stamps if stamp != 440]  # one gap is twice as long
    assert not any(Need(rhythm(*lost), 50, 0).unmet(instant) for instant in range(220, 1210))


@given(period=st.integers(20, 200), phase=st.integers(0, 200), arrives=st.integers(0, 50))
def test_the_next_must_is_the_first_frame_ahead_that_is_a_must_by_itself(
    period: int, phase: int, arrives: int
) -> None:
    wish = MustWish(even(period, phase), Sync.NEAREST, 4, 0)
    last = phase + 8 * period
    frames = rhythm(*range(last - 80, last + 1, 10), arrives=arrives)
    ahead = [n for n in range(1, AHEAD + 1) if wish.meets(last + 10 * n, 10, 10)]
    expected = last + arrives + 10 * ahead[0] if ahead else None
    assert Wishes([wish]).next_must(frames, last) == expected


def test_a_dead_camera_lets_nobody_wait_for_its_next_frame() -> None:
    wishes = Wishes([MustWish(even(100), Sync.NEAREST, 50, 0)])
    frames = even(10, 700)
    assert wishes.next_must(frames, 780) is not None
    assert wishes.next_must(frames, 780 + 31) is None
