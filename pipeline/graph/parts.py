"""Makes the stages and devices of a file once: imports the class, binds its options, constructs
it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from pipeline.graph.contract import CALIBRATION, Contract, ContractError, contract_of
from pipeline.graph.nodes import Node, Steps
from pipeline.graph.options import CalibrationBlock, bind_options, build, device_class, import_name
from pipeline.graph.report import Report
from pipeline.graph.spec import DEVICE_KEYS
from pipeline.model import Accelerator
from pipeline.stage import Stage

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Part(Generic[T]):
    """A class of the file with its options; `instance` is None where these are wrong."""

    use: str
    cls: type[T]
    options: Mapping[str, Any]
    instance: T | None


@dataclass(frozen=True, slots=True)
class StagePart(Part[Stage]):
    """A stage of the file."""

    contract: Contract


class PartMaker:
    """Makes parts from the merged file and reports what is wrong with them."""

    def __init__(self, tree: Node, report: Report) -> None:
        self._tree = tree
        self._report = report
        self._block = tree.get(CALIBRATION) or Node(None, tree.mark)
        self._calibration = CalibrationBlock(self._block, report)

    def device(self, name: str, use: str) -> Part[Accelerator] | None:
        """The device; None where its class is wrong."""
        steps: Steps = ("devices", name)
        try:
            cls, wanted = device_class(use)
        except (ImportError, ContractError) as error:
            self._report.mistake((*steps, "use"), str(error))
            return None
        entries = self._report.entries(steps)
        given = {key: node for key, node in entries.items() if key not in DEVICE_KEYS}
        options = bind_options(wanted, use, given, steps, self._report)
        instance = None if options is None else build(cls, options, steps, self._report)
        return Part(use, cls, options or {}, instance)

    def stage(self, name: str, use: str) -> StagePart | None:
        """The stage; None where its class is wrong."""
        steps: Steps = ("stages", name)
        try:
            cls = import_name(use)
            if not isinstance(cls, type) or not issubclass(cls, Stage):
                raise ContractError(f"{use} is no Stage; derive it from pipeline.stage.Stage")
            contract = contract_of(cls)
        except (ImportError, ContractError) as error:
            self._report.mistake((*steps, "use"), str(error))
            return None
        options = self._stage_options(steps, use, contract)
        at = (*steps, "options") if self._report.has((*steps, "options")) else steps
        instance = None if options is None else build(cls, options, at, self._report)
        return StagePart(use, cls, options or {}, instance, contract)

    def _stage_options(self, steps: Steps, use: str, contract: Contract) -> dict[str, Any] | None:
        at = (*steps, "options")
        written = self._tree.get(*at)
        if written is not None and not isinstance(written.value, (dict, type(None))):
            return None  # not a mapping, as the report says already
        options = bind_options(contract.options, use, self._report.entries(at), at, self._report)
        wanted = contract.calibration
        if wanted is None:
            return options
        if self._block.value is None:
            if not wanted.required:
                return options
            what = "needs the calibration of the sensors; add a 'calibration' block to the file"
            self._report.mistake(steps, what)
            return None
        if not isinstance(self._block.value, dict):
            return None  # as the report says already
        calibration = self._calibration.value_for(wanted)
        if options is None or calibration is None:
            return None
        return {**options, CALIBRATION: calibration}
