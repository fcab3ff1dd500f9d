from __future__ import annotations

from pathlib import Path

from accelerators.registry import Registry
from pipeline.graph.graph import load_graph
from pipeline.graph.run_folder import folder_of_this_run, run_folder

GRAPH = """\
overflight: 1
graph: pictures
stages: {images: {use: stages.sources.images:ImageFolder, options: {path: $run/images}}}
"""


def test_the_folder_of_a_run_is_empty_at_its_start_and_gone_at_its_end(tmp_path: Path) -> None:
    file = tmp_path / "pictures.yaml"
    file.write_text(GRAPH)
    graph = load_graph(file, catalog=Registry.open(), out=tmp_path / "out")
    [stage] = graph.stages
    assert stage.options["path"] == run_folder(tmp_path / "out") / "images"
    left = run_folder(tmp_path / "out") / "left_by_a_killed_run"
    left.parent.mkdir(parents=True)
    left.touch()
    with folder_of_this_run(graph):
        assert not left.exists()
        left.parent.mkdir()
        left.touch()
    assert list((tmp_path / "out").iterdir()) == []
