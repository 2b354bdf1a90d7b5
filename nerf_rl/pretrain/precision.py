"""In which precision a training step computes."""

import torch


def computes_bfloat16(device: torch.device) -> bool:
    """Tell whether a device multiplies matrices in bfloat16 itself; before Ampere, CUDA only emulates it."""
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return torch.cpu._is_avx512_bf16_supported() or torch.cpu._is_amx_tile_supported()


def in_full_precision(device: torch.device) -> torch.autocast:
    """Compute what follows in the precision of its tensors.

    All that turns z into something, or something into z, does: bfloat16 keeps eight bits, which is less than z varies
    by early in training (0.0016 against 0.0014), and would move an origin at half a metre by a millimetre.
    """
    return torch.autocast(device.type, enabled=False)
