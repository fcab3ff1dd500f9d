"""The process of an isolated device: makes it, loads its models, infers when asked.

Run as ``python -m pipeline.drivers.isolated_child DESCRIPTOR PARENT NAME``.
"""

from __future__ import annotations

import contextlib
import socket
import sys
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from pipeline.drivers.threads import name_this_thread
from pipeline.errors import OverflightError
from pipeline.graph.blocks import make_device
from pipeline.model import Accelerator, Model, TensorSpec
from pipeline.transport.child_end import end_with
from pipeline.transport.mailbox import Arrays, Closed, Mailbox


class Server:
    """Answers the calls of `IsolatedDevice`."""

    def __init__(self, device: Accelerator) -> None:
        self._device = device
        self._models: list[Model] = []

    def answer(
        self, header: Mapping[str, Any], arrays: Arrays
    ) -> tuple[Mapping[str, Any], Arrays | None]:
        """The answer to one call. Raises what the device raises."""
        call = header["call"]
        if call == "infer":
            return {}, self._models[header["model"]].infer(arrays)
        if call == "load":
            model = self._device.load(header["path"], header["variant"])
            self._models.append(model)
            said = {"inputs": _said(model.inputs), "outputs": _said(model.outputs)}
            return {"model": len(self._models) - 1, **said}, None
        return {"probe": asdict(self._device.probe())}, None


def serve(mailbox: Mailbox, name: str) -> None:
    """Make the device that the first call describes, then answer until the other side is gone."""
    server: Server | None = None
    while True:
        header, arrays = mailbox.receive()
        outputs: Arrays | None = None
        answer: Mapping[str, Any] = {}
        try:
            if server is None:
                sys.path[:] = header["path"]
                server = Server(make_device(name, header["use"], header["block"]))
            else:
                answer, outputs = server.answer(header, arrays)
        except Exception as error:  # whatever a runtime raises ends this call, not the process
            ours = isinstance(error, OverflightError)
            text = str(error) if ours else f"{type(error).__name__}: {error}"
            answer = {"error": type(error).__name__, "text": text}
        mailbox.send(answer, outputs)


def main() -> None:
    """Serve on the descriptor in the arguments until the parent is gone."""
    descriptor, parent, name = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
    if not end_with(parent):
        return
    name_this_thread(f"dev-{name}")
    with contextlib.suppress(Closed):
        serve(Mailbox(socket.socket(fileno=descriptor)), name)


def _said(specs: Mapping[str, TensorSpec]) -> Mapping[str, Any]:
    return {n: [list(s.shape), s.dtype, s.scale, s.zero_point] for n, s in specs.items()}


if __name__ == "__main__":
    main()
