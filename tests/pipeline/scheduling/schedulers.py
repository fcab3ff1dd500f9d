"""The schedulers that the tests of this folder run on: the reference and the real one."""

from __future__ import annotations

import importlib
import importlib.util

import pytest
from reference import ReferenceScheduler
from virtual_time import Scheduling

REAL: type[Scheduling] = ReferenceScheduler
missing = pytest.mark.skipif(
    importlib.util.find_spec("pipeline.scheduling.scheduler") is None,
    reason="pipeline.scheduling.scheduler is not there",
)
if not missing.args[0]:
    REAL = importlib.import_module("pipeline.scheduling.scheduler").Scheduler

every_scheduler = pytest.mark.parametrize(
    "scheduler",
    [
        pytest.param(ReferenceScheduler, id="reference"),
        pytest.param(REAL, id="real", marks=missing),
    ],
)
