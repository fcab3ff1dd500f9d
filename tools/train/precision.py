"""In which numbers this CPU learns fastest."""

from __future__ import annotations

import torch


def has_bfloat16() -> bool:
    """Whether the CPU multiplies bfloat16 itself (AVX512-BF16 or AMX: 2 to 4 times as fast).

    Elsewhere torch emulates it, in several times the time of float32.
    """
    return bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())
