"""In which precision a training step computes."""

from typing import Any

import torch

_LIGHTNING = {"32": "32-true", "bf16": "bf16-mixed"}


def resolve_precision(name: str, device: torch.device) -> str:
    """Return ``32`` or ``bf16``; ``auto`` takes what was measured to train better on such a device.

    Processors that multiply bfloat16 (in tiles, as Intel's AMX does, or in vectors, AVX-512 BF16) do a quarter to two
    fifths more steps in it in the same time, and end with a better encoder (pretrain/README.md). An H100 does fewer
    steps in it; nobody has compared the two on other processors, so there it is 32.
    """
    if name != "auto":
        return name
    return "bf16" if device.type == "cpu" and multiplies_bfloat16() else "32"


def lightning_precision(name: str) -> Any:
    """Return Lightning's name of ``32`` or ``bf16``."""
    return _LIGHTNING[name]


def multiplies_bfloat16() -> bool:
    """Tell whether the processor has instructions that multiply bfloat16: others would emulate them."""
    return torch.cpu._is_amx_tile_supported() or torch.cpu._is_avx512_bf16_supported()


def in_full_precision(device: torch.device) -> torch.autocast:
    """Compute what follows in the precision of its tensors.

    All that turns z into something, or something into z, does: bfloat16 keeps eight bits, which is less than z varies
    by early in training (0.0016 against 0.0014), and would move an origin at half a metre by a millimetre.
    """
    return torch.autocast(device.type, enabled=False)
