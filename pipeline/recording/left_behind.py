"""What the earlier start of a process left for the next, kept with the recording of the next.

Such files lie in ``$run`` (`pipeline/graph/run_folder.py`): a map's checkpoint. Without them a
process that was started anew would not be replayed from where it began.
"""

from __future__ import annotations

import logging
from pathlib import Path, PurePosixPath

from pipeline.errors import DataError
from pipeline.recording.mcap import MAX_RECORD_BYTES, McapReader, McapWriter

#: What the names of these attachments begin with.
_PREFIX = "run/"
_log = logging.getLogger(__name__)


def keep(file: McapWriter, folder: Path) -> None:
    """Attach every file of a folder. One that no reader would take is left out, and told."""
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        if path.stat().st_size >= MAX_RECORD_BYTES:
            _log.warning("%s is too large for the recording: its replay begins without", path)
            continue
        file.attach(_PREFIX + path.relative_to(folder).as_posix(), path.read_bytes())


def restore(reader: McapReader, folder: Path) -> None:
    """Write what was attached into a folder. Raises DataError for a name that leads out of it."""
    for name, data in reader.attachments():
        inside = PurePosixPath(name.removeprefix(_PREFIX))
        if not name.startswith(_PREFIX):
            continue
        if inside.is_absolute() or ".." in inside.parts or not inside.parts:
            raise DataError(f"{reader.path}: damaged: an attachment is called '{name}'")
        path = folder / inside
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
