"""Record, look, replay and explain, as a user does it."""

from __future__ import annotations

import json
import multiprocessing
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import pytest
from recording_runs import rewrite

from pipeline.recording.mcap import Record

Overflight = Callable[..., Any]

GRAPH = """\
overflight: 1
graph: pairs
parameters: {rate: 30}
stages:
  camera: {use: stages.sources.emulated:EmulatedCamera,
           options: {width: 64, height: 32, rate_hz: $rate, count: 15, seed: 4}}
  lidar: {use: stages.sources.emulated:EmulatedLidar, options: {rows: 4, columns: 32, count: 5}}
  pair:
    use: recorded_pairing:Pair
    inputs: {scan: lidar, image: {from: camera, sync: nearest, tolerance_ms: 40}}
  picture: {use: recorded_pairing:Write, options: {folder: $out/numbers}, inputs: {pair: pair}}
"""
STAGES = """\
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from numpy.typing import NDArray
from pipeline.message import Message
from pipeline.stage import Stage
from stages.types import Image, Scan

@dataclass(frozen=True)
class Pairing:
    '''A scan with the mean of its image.'''
    mean: float
    points: NDArray[np.float32]

class Pair(Stage):
    '''Pairs a scan with its image.'''

    def __init__(self, *, factor: float = 1.0) -> None:
        self.factor = factor

    def process(self, scan: Message[Scan], image: Message[Image]) -> Pairing:
        return Pairing(self.factor * float(image.payload.data.mean()), scan.payload.points)

class Write(Stage):
    '''A file per pair.'''

    def __init__(self, *, folder: Path) -> None:
        self.folder = folder

    def open(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)

    def process(self, pair: Message[Pairing]) -> None:
        (self.folder / f"{pair.stamp}.txt").write_text(f"{pair.payload.mean}")
"""


@pytest.fixture
def flown(tmp_path: Path, overflight: Overflight, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recorded run, offline, with its graph beside it."""
    (tmp_path / "pairs.yaml").write_text(GRAPH)
    (tmp_path / "recorded_pairing.py").write_text(STAGES)
    monkeypatch.syspath_prepend(str(tmp_path))
    done = overflight(
        *("run", "pairs.yaml", "--set", "parameters.rate=15", "--speed", "max", "--quiet"),
        *("--record", "f.mcap", "--record-edges", "sources,pair", "--out", "flown"),
    )
    assert done.code == 0, done.err
    return tmp_path


def numbers(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in (folder / "numbers").iterdir()}


def words_of(text: str) -> str:
    """A text without the frame that it stands in."""
    return " ".join(text.replace("│", " ").split())


def test_a_flight_is_replayed_from_its_own_file(flown: Path, overflight: Overflight) -> None:
    (flown / "pairs.yaml").unlink()  # the file brings it
    done = overflight("run", "f.mcap", "--as-recorded", "--out", "again", "--json", "--quiet")
    assert done.code == 0, done.err
    replay = json.loads(done.out)["replay"]
    assert replay["decisions_identical"]
    assert (replay["outputs_compared"], replay["outputs_different"]) == (25, 0)
    assert replay["surroundings"] == []
    assert numbers(flown / "again") == numbers(flown / "flown")


def test_a_flight_feeds_its_own_graph_or_another_at_any_speed(
    flown: Path, overflight: Overflight
) -> None:
    for number, words in enumerate((["f.mcap"], ["pairs.yaml", "f.mcap"])):
        out = f"again{number}"
        done = overflight("run", *words, "--speed", "max", "--out", out, "--quiet")
        assert done.code == 0, done.err
        assert numbers(flown / out) == numbers(flown / "flown")


OWN = """\
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import numpy as np
from numpy.typing import NDArray
from pipeline.message import Message
from pipeline.stage import Source, Stage

@dataclass(frozen=True)
class Echoes:
    '''What a radar hears.'''
    ranges_m: NDArray[np.float32]

class Radar(Source):
    '''A radar that hears more every time.'''

    def messages(self) -> Iterator[Message[Echoes]]:
        for k in range(4):
            yield Message.at(k * 100_000_000, Echoes(np.arange(k, dtype=np.float32)))

class Write(Stage):
    '''A file per message.'''

    def __init__(self, *, folder: Path) -> None:
        self.folder = folder

    def open(self) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)

    def process(self, echoes: Message[Echoes]) -> None:
        (self.folder / f"{echoes.stamp}.txt").write_text(f"{echoes.payload.ranges_m.sum()}")
"""
RADAR = """\
overflight: 1
graph: radar
stages:
  radar: {use: radar_stages:Radar}
  write: {use: radar_stages:Write, options: {folder: $out/numbers}, inputs: {echoes: radar}}
"""


def test_a_sensor_of_ones_own_is_replayed_as_the_class_that_the_graph_declares(
    tmp_path: Path, overflight: Overflight, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "radar_stages.py").write_text(OWN)
    (tmp_path / "radar.yaml").write_text(RADAR)
    recorded = "stages.sources.recording:Recording, options: {path: r.mcap, topic: radar}"
    (tmp_path / "file.yaml").write_text(RADAR.replace("radar_stages:Radar", recorded))
    monkeypatch.syspath_prepend(str(tmp_path))
    words = ("--speed", "max", "--quiet")
    done = overflight("run", "radar.yaml", *words, "--record", "r.mcap", "--out", "flown")
    assert done.code == 0, done.err
    assert len(numbers(tmp_path / "flown")) == 4
    done = overflight("run", "radar.yaml", "r.mcap", *words, "--out", "again")
    assert done.code == 0, done.err
    assert numbers(tmp_path / "again") == numbers(tmp_path / "flown")
    # A graph without that source says it itself: what a file names is not imported.
    done = overflight("run", "file.yaml", *words, "--out", "file")
    assert done.code == 2
    assert "say 'payloads: [radar_stages:Echoes]' to have it read as that" in words_of(done.err)
    for given, code, told in (
        ("radar_stages:Echoes", 0, ""),
        ("radar_stages:Echo", 2, "did you mean 'Echoes'"),
        ("radar_stages:Radar", 2, "is no dataclass"),
    ):
        setting = f"stages.radar.options.payloads=[{given}]"
        done = overflight("run", "file.yaml", *words, "--out", "file", "--set", setting)
        assert done.code == code, done.err
        assert told in words_of(done.err)
    assert numbers(tmp_path / "file") == numbers(tmp_path / "flown")


def test_a_flight_in_several_files_feeds_each_source_from_the_one_that_holds_it(
    flown: Path, overflight: Overflight
) -> None:
    for part, edges in (("main", "camera"), ("far", "lidar"), ("far.2", "lidar")):
        words = ("--set", "parameters.rate=15", "--speed", "max", "--quiet", "--out", "parts")
        record = ("--record", f"g.{part}.mcap", "--record-edges", edges)
        assert overflight("run", "pairs.yaml", *words, *record).code == 0
    refused = overflight("run", "g.mcap", "--speed", "max")
    assert refused.code == 2
    assert "name one in place of the flight: g.far.mcap or g.far.2.mcap" in refused.err
    (flown / "g.far.2.mcap").unlink()
    for number, words in enumerate((["g.mcap"], ["pairs.yaml", "g.mcap"])):
        out = f"again{number}"
        done = overflight("run", *words, "--speed", "max", "--out", out, "--quiet")
        assert done.code == 0, done.err
        assert numbers(flown / out) == numbers(flown / "flown")


def test_faults_act_in_flight_once_and_over_a_replayed_flight_where_asked(
    flown: Path, overflight: Overflight
) -> None:
    """A flight's own messages have been through its faults; an overlay may bring others."""
    (flown / "dies.yaml").write_text("faults: {sources: {lidar: {dies_at_s: 0.15}}}")
    (flown / "late.yaml").write_text("faults: {sources: {lidar: {repeats_at_s: 0.05}}}")
    done = overflight(
        *("run", "pairs.yaml", "--overlay", "dies.yaml", "--speed", "max", "--quiet"),
        *("--record", "g.mcap", "--record-edges", "sources,pair", "--out", "fault"),
    )
    assert done.code == 0, done.err
    died = numbers(flown / "fault")
    assert 0 < len(died) < 5
    again = ("--out", "again", "--json", "--quiet")
    done = overflight("run", "g.mcap", "--as-recorded", *again)
    assert done.code == 0, done.err
    assert json.loads(done.out)["replay"]["decisions_identical"]
    report = json.loads(overflight("run", "g.mcap", "--speed", "max", *again).out)
    assert [event for event in report["events"] if event["kind"] == "fault"] == []
    assert numbers(flown / "again") == died
    words = ("run", "pairs.yaml", "f.mcap", "--overlay", "dies.yaml", "--speed", "max", "--quiet")
    assert overflight(*words, "--out", "over").code == 0
    assert numbers(flown / "over").keys() == died.keys()
    report = json.loads(
        overflight("run", "g.mcap", "--overlay", "late.yaml", "--speed", "max", *again).out
    )
    assert [event["of"] for event in report["events"] if event["kind"] == "fault"] == ["lidar"]


def test_other_code_is_found_out_and_named(flown: Path, overflight: Overflight) -> None:
    done = overflight(
        *("run", "pairs.yaml", "f.mcap", "--as-recorded", "--set", "parameters.rate=15"),
        *("--set", "stages.pair.options.factor=2", "--out", "again"),
    )
    assert done.code == 1
    assert "5 outputs are not as recorded, the first: pair/out at stamp" in done.err
    assert "another option: pair.factor: 1.0 in the flight, 2.0 here" in done.out


def test_other_rules_are_refused_by_name(flown: Path, overflight: Overflight) -> None:
    done = overflight(
        *("run", "pairs.yaml", "f.mcap", "--as-recorded"),
        *("--set", "stages.pair.inputs.image.tolerance_ms=50"),
    )
    assert done.code == 2
    assert "stages.pair.inputs.image.tolerance: 40000000 in the recording, 50000000" in done.err


def test_a_stage_is_fed_where_it_was_recorded_and_else_refused(
    flown: Path, overflight: Overflight
) -> None:
    done = overflight("run", "f.mcap", "--as-recorded", "--feed", "pair", "--out", "again")
    assert done.code == 0, done.err
    assert "pair: not executed, its recorded outputs were taken (as asked)" in done.out
    assert numbers(flown / "again") == numbers(flown / "flown")
    overflight(
        *("run", "pairs.yaml", "--speed", "max", "--quiet", "--record", "g.mcap", "--out", "x")
    )
    done = overflight("run", "g.mcap", "--as-recorded", "--feed", "pair")
    assert done.code == 2
    assert "not recorded losslessly: pair/out" in done.err
    assert "--record-edges sources,pair/out" in done.err


def test_a_source_that_was_not_recorded_is_refused(flown: Path, overflight: Overflight) -> None:
    overflight(
        *("run", "pairs.yaml", "--speed", "max", "--quiet", "--out", "x"),
        *("--record", "g.mcap", "--record-edges", "camera"),
    )
    done = overflight("run", "g.mcap", "--as-recorded")
    assert done.code == 2
    assert "the source lidar/out was not recorded" in done.err
    done = overflight("run", "g.mcap", "--speed", "max")
    assert done.code == 2
    assert "nothing recorded of the sources lidar" in done.err


def test_info_tells_what_is_in_a_file(flown: Path, overflight: Overflight) -> None:
    done = overflight("info", "f.mcap", "--json")
    assert done.code == 0, done.err
    info = json.loads(done.out)
    topics = {topic["name"]: topic for topic in info["topics"]}
    assert topics["camera"]["schema"] == "foxglove.RawImage"
    assert topics["camera"]["rate_hz"] == pytest.approx(15, rel=0.01)
    assert (topics["camera"]["messages"], topics["camera"]["lossless"]) == (15, True)
    assert topics["pair"]["payload"] == "Pairing"
    assert info["run"]["options"]["camera"]["seed"] == "4"
    assert info["whole"]
    assert (info["gap"], info["first_loss"]) == (None, None)
    text = overflight("info", "f.mcap").out
    assert "Graph pairs, run offline" in text
    assert "rate_hz: 15" in overflight("info", "f.mcap", "--graph").out


def test_explain_tells_why_a_stage_ran(flown: Path, overflight: Overflight) -> None:
    done = overflight("explain", "f.mcap", "--stage", "pair", "--picture", "p.png")
    assert done.code == 0, done.err
    assert "pair: 5 triggers: 5 fired" in done.out
    assert "image from camera" in done.out
    picture = cv2.imread(str(flown / "p.png"))
    assert picture is not None
    assert picture.std() > 5
    one = json.loads(
        overflight("explain", "f.mcap", "--stage", "pair", "--at", "0.2", "--json").out
    )
    (trigger,) = one["triggers"]
    assert trigger["inputs"][0]["verdict"] == "settled"
    beyond = overflight("explain", "f.mcap", "--stage", "pair", "--at", "99")
    assert beyond.code == 0
    assert "Nothing triggers pair at 99 s" in " ".join(beyond.err.split())
    assert overflight("explain", "f.mcap", "--stage", "pare").code == 2
    assert (
        "nothing is decided there; ask of pair"
        in overflight("explain", "f.mcap", "--stage", "camera").err
    )


def test_wrong_words_have_a_way_out(flown: Path, overflight: Overflight) -> None:
    done = overflight("run", "pairs.yaml", "--record", "x.mcap", "--record-edges", "camra")
    assert "did you mean 'camera'" in words_of(done.err)
    assert "is no flight" in words_of(overflight("run", "pairs.yaml", "--as-recorded").err)
    for words in (["info"], ["explain", "--stage", "pair"], ["run", "--as-recorded"]):
        done = overflight(words[0], "recorded_pairing.py", *words[1:])
        assert done.code == 2
        assert "Traceback" not in done.err
        assert done.err.count("recorded_pairing.py") == 1


def _burn() -> None:
    while True:
        sum(range(100_000))


@pytest.fixture
def load() -> Iterator[None]:
    """Two cores' worth of other work."""
    burners = [multiprocessing.Process(target=_burn, daemon=True) for _ in range(2)]
    for burner in burners:
        burner.start()
    yield
    for burner in burners:
        burner.kill()
        burner.join()


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.usefixtures("load")
def test_the_emulated_uav_recorded_under_load_is_repeated_to_the_bit(
    root: Path, tmp_path: Path, overflight: Overflight
) -> None:
    done = overflight(
        *("run", root / "graphs/emulated_uav.yaml", "--duration", "2", "--quiet"),
        *("--record", "f.mcap", "--out", "flown", "--report", "r.json"),
    )
    assert done.code == 0, done.err
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["stages"]["fuse_cloud"]["runs"] > 0
    done = overflight("run", "f.mcap", "--as-recorded", "--out", "again", "--json", "--quiet")
    assert done.code == 0, done.err
    page = json.loads(done.out)
    replay = page["replay"]
    assert replay["decisions_identical"]
    assert replay["outputs_different"] == 0
    assert replay["outputs_compared"] > 200
    assert page["edges"] == report["edges"]
    assert {name: stage["runs"] for name, stage in page["stages"].items()} == {
        name: stage["runs"] for name, stage in report["stages"].items()
    }

    changed = _another_image(tmp_path / "f.mcap")
    done = overflight("run", "f.mcap", "--as-recorded", "--out", "again")
    assert done.code == 1
    assert f"the first: rgb/out at stamp {changed / 1e9:.6f} s" in done.err


def _another_image(path: Path) -> int:
    """Change one bit of one image that the networks saw; its stamp."""
    stamps: list[int] = []

    def change(entry: Record) -> Record:
        if entry.topic != "rgb" or entry.seq != 3:
            return entry
        stamps.append(entry.stamp)
        data = bytearray(entry.data)
        data[len(data) // 2] ^= 1
        return replace(entry, data=bytes(data))

    rewrite(path, change)
    return stamps[0]
