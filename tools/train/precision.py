"""In which numbers this CPU learns fastest."""

from __future__ import annotations

import torch


def has_bfloat16() -> bool:
    """Whether the CPU multiplies bfloat16 itself (AVX512-BF16 or AMX: 2 to 4 times as fast).

    Elsewhere torch emulates it, which takes 2 to 3 times as long as float32; what oneDNN calls
    supported includes that.
    """
    able = torch.cpu.get_capabilities()
    return bool(able.get("avx512_bf16") or able.get("amx_bf16") or able.get("bf16"))
