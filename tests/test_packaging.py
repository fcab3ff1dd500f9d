"""The built wheel holds what it should and answers on its own."""

from __future__ import annotations

import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

PACKAGES = {"pipeline", "accelerators", "stages", "graphs", "tools"}


@pytest.fixture(scope="module")
def wheel(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel, built offline by the backend that pyproject.toml names."""
    pytest.importorskip("hatchling", reason="needs hatchling, the build backend, to build a wheel")
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)],
        cwd=root,
        check=True,
        capture_output=True,
    )
    (built,) = folder.glob("*.whl")
    return built


@pytest.mark.slow
def test_the_wheel_holds_the_five_packages_and_nothing_else(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == PACKAGES


@pytest.mark.slow
def test_the_wheel_holds_every_file_of_the_packages(wheel: Path, root: Path) -> None:
    held = set(zipfile.ZipFile(wheel).namelist())
    files = (file for package in PACKAGES for file in (root / package).rglob("*.*"))
    kept = {str(file.relative_to(root)) for file in files if "__pycache__" not in file.parts}
    assert kept <= held


@pytest.mark.slow
def test_an_installed_wheel_answers_its_version(wheel: Path, root: Path, tmp_path: Path) -> None:
    # The venv borrows the dependencies of this one; only Overflight itself is installed.
    venv.create(tmp_path / "venv", with_pip=False)
    binary = tmp_path / "venv" / "bin"
    (site,) = (tmp_path / "venv" / "lib").glob("python*/site-packages")
    pip = [sys.executable, "-m", "pip", "--python", str(binary / "python")]
    flags = ["--quiet", "--disable-pip-version-check", "--no-deps", "--no-index"]
    subprocess.run([*pip, "install", *flags, str(wheel)], check=True)
    (site / "borrowed.pth").write_text(f"{Path(pytest.__file__).parent.parent}\n")
    answer = subprocess.run(
        [str(binary / "overflight"), "--version"], check=True, capture_output=True, text=True
    )
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    assert answer.stdout == f"overflight {version}\n"


def test_the_changelog_names_the_version_of_the_package(root: Path) -> None:
    version = tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"]
    assert f"## {version}" in (root / "CHANGELOG.md").read_text()
