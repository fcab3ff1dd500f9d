"""The training loop: one step after another, stopped and resumed at will, with its curve on disk.

Batch k is drawn from (seed, k) alone, so a training that was interrupted and went on gives the same
weights as one that was not.
"""

from __future__ import annotations

import contextlib
import copy
import signal
import threading
import time
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from torch import Tensor, nn

from pipeline.errors import DataError
from tools.train.checkpoint import CHECKPOINT, opened
from tools.train.curve import Curve
from tools.train.precision import has_bfloat16
from tools.train.task import Settings, Task

#: A crash costs at most this.
SAVE_EVERY_S = 60.0
#: A row of the curve stands for so many steps, and a line where there is no terminal for ten rows.
ROW_STEPS = 20


class Interrupted(Exception):
    """Ctrl-C: everything is saved, and the same command goes on."""

    def __init__(self, step: int) -> None:
        super().__init__(f"stopped at step {step}")
        self.step = step


class Training:
    """One training in one folder, from its checkpoint where there is one."""

    def __init__(self, task: Task, settings: Settings, folder: Path) -> None:
        torch.set_num_threads(settings.threads)
        self.task = task
        self.settings = settings
        self.folder = folder
        self.step = 0
        self.seconds = 0.0
        self.network = task.network.to(memory_format=torch.channels_last).train()
        self.averaged = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.optimizer = torch.optim.AdamW(
            _groups(self.network, settings.weight_decay), settings.rate
        )
        self._bfloat16 = has_bfloat16()
        self.curve = Curve(folder / "curve.csv")
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / CHECKPOINT).is_file():
            self._resume()

    def run(self, console: Console) -> nn.Module:
        """Train to the end; the averaged network. Raises Interrupted, having saved."""
        saved = time.monotonic()
        with (
            _Bar(self.settings.steps, self.step, console) as bar,
            _Interruption() as interruption,
            contextlib.closing(self._batches()) as batches,
        ):
            for batch in batches:
                started = time.monotonic()
                parts = self._learn(batch)
                self.step += 1
                self.seconds += time.monotonic() - started
                self.curve.add(self.step, self.settings.rate_at(self.step - 1), parts)
                bar.show(self.step, self.curve.lately)
                if self.step % ROW_STEPS == 0 or self.step == self.settings.steps:
                    self.curve.write_row(self.seconds)
                if interruption.asked:
                    break
                if time.monotonic() - saved > SAVE_EVERY_S:
                    self.save()
                    saved = time.monotonic()
        self.save()
        if self.step < self.settings.steps:
            raise Interrupted(self.step)
        return self.averaged

    def _batches(self) -> Generator[list[dict[str, Tensor]], None, None]:
        """The remaining batches; the next one is made while this one is learned from."""
        steps = range(self.step, self.settings.steps)
        with ThreadPoolExecutor(1, "batches") as pool:
            ahead: list[Future[list[dict[str, Tensor]]]] = []
            for step in steps:
                ahead.append(pool.submit(self._batch, step))
                if len(ahead) > 2:
                    yield ahead.pop(0).result()
            for future in ahead:
                yield future.result()

    def _batch(self, step: int) -> list[dict[str, Tensor]]:
        random = np.random.default_rng([self.settings.seed, step])
        return [self.task.batch(random) for _ in range(self.settings.gathered)]

    def _learn(self, batches: list[dict[str, Tensor]]) -> dict[str, float]:
        """One step; the gradients of all the batches are added up, each batch by itself."""
        torch.manual_seed(self.settings.seed * 1_000_003 + self.step)  # dropout
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.rate_at(self.step)
        self.optimizer.zero_grad(set_to_none=True)
        told: dict[str, float] = {}
        for batch in batches:
            picture = batch["input"].contiguous(memory_format=torch.channels_last)
            with torch.autocast("cpu", torch.bfloat16, enabled=self._bfloat16):
                outputs = self.network(picture)
            parts = self.task.loss(outputs, batch)
            total = torch.stack(list(parts.values())).sum()
            if not torch.isfinite(total):
                raise DataError(
                    f"the loss is {float(total.detach())} at step {self.step}: the rate "
                    f"{self.settings.rate} is too high, or the data holds numbers that are none"
                )
            (total / len(batches)).backward()
            for name, part in parts.items():
                told[name] = told.get(name, 0.0) + float(part.detach()) / len(batches)
        nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.largest_gradient)
        self.optimizer.step()
        self._average()
        return told

    @torch.no_grad()
    def _average(self) -> None:
        # A young average follows quickly, or the random start would stay in it for long.
        keep = min(self.settings.averaging, (self.step + 1) / (self.step + 10))
        mine = list(self.averaged.state_dict().values())
        theirs = list(self.network.state_dict().values())
        for mean, value in zip(mine, theirs, strict=True):
            if mean.is_floating_point():
                mean.lerp_(value, 1 - keep)
            else:
                mean.copy_(value)

    def save(self) -> None:
        """Write the checkpoint as a whole, and draw the curve."""
        beside = self.folder / (CHECKPOINT + ".new")
        state = {
            "step": self.step,
            "seconds": self.seconds,
            "settings": _comparable(self.settings),
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        torch.save(state, beside)
        beside.replace(self.folder / CHECKPOINT)
        self.curve.draw(self.folder / "curve.png")

    def _resume(self) -> None:
        path = self.folder / CHECKPOINT
        with opened(path, purpose="be resumed", advice="--restart begins anew") as state:
            was, now = state["settings"], _comparable(self.settings)
            other = [name for name in now if was.get(name) != now[name]]
            if other:
                raise DataError(
                    f"{path}: is of a training with other settings ("
                    + ", ".join(f"{name}: {was.get(name)}, now {now[name]}" for name in other)
                    + "); give them again, another folder, or --restart"
                )
            self.network.load_state_dict(state["network"])
            self.averaged.load_state_dict(state["averaged"])
            self.optimizer.load_state_dict(state["optimizer"])
            self.step, self.seconds = state["step"], state["seconds"]
        self.curve.cut(self.step)


def _groups(network: nn.Module, weight_decay: float) -> list[dict[str, Any]]:
    """Weights decay; biases and normalizations do not."""
    weights = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim <= 1]
    return [
        {"params": weights, "weight_decay": weight_decay},
        {"params": others, "weight_decay": 0.0},
    ]


def _comparable(settings: Settings) -> dict[str, Any]:
    return {
        "steps": settings.steps,
        "seed": settings.seed,
        "rate": settings.rate,
        **{name: str(value) for name, value in settings.facts.items()},
    }


class _Interruption:
    """Ctrl-C between two steps: in the middle of one, half of the network has learned from it."""

    def __enter__(self) -> Self:
        self.asked = False
        self._main = threading.current_thread() is threading.main_thread()
        if self._main:
            self._before = signal.signal(signal.SIGINT, self._ask)
        return self

    def __exit__(self, *_: object) -> None:
        if self._main:
            signal.signal(signal.SIGINT, self._before)

    def _ask(self, *_: object) -> None:
        if self.asked:  # a second one means it
            raise KeyboardInterrupt
        self.asked = True


class _Bar:
    """A progress bar on a terminal, else a line now and then."""

    def __init__(self, steps: int, done: int, console: Console) -> None:
        self._console = console
        self._steps = steps
        self._progress = Progress(
            TextColumn("training"),
            BarColumn(),
            TextColumn("{task.completed}/{task.total}  loss {task.fields[loss]:.3f}"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._task = self._progress.add_task("training", total=steps, completed=done, loss=np.nan)

    def __enter__(self) -> _Bar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    def show(self, step: int, loss: float) -> None:
        self._progress.update(self._task, completed=step, loss=loss)
        if not self._console.is_terminal and step % (10 * ROW_STEPS) == 0:
            self._console.print(f"step {step} of {self._steps}, loss {loss:.3f}", highlight=False)
