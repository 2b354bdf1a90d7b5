"""What may go wrong in a training step, told so that the user can mend it."""

import torch

from nerf_rl.errors import FailureError

FAILED_BATCH = "failed_batch.json"
_OUT_OF_MEMORY = ("out of memory", "can't allocate memory", "DefaultCPUAllocator")
_KEPT = "the last checkpoint, if there is one, is from before"
_KEYS = "--scenes_per_step, --rays_per_scene, --sampling.* or --radiance_field.width"


class NotFiniteError(FailureError):
    """A step's gradient is not finite; the weights are those before it."""

    def __init__(self, step: int, losses: dict[str, float]):
        self.step, self.losses = step, losses
        named = ", ".join(f"{name} {value:.3g}" for name, value in losses.items())
        super().__init__(
            f"the gradient of step {step} is not finite ({named}), so it was not taken: {FAILED_BATCH} names its "
            f"frames, and {_KEPT}; look at those frames, or begin anew with a lower --learning_rate or --precision 32"
        )


class SpoiltWeightsError(FailureError):
    """The gradients were finite, and yet what the weights compute is not; the last checkpoint is from before."""

    def __init__(self, step: int, what: str):
        super().__init__(
            f"the run diverged: after step {step} {what} are not finite; {_KEPT}; begin anew with a lower "
            "--learning_rate or --precision 32"
        )


class OutOfMemoryError(FailureError):
    """There is not enough memory for a step."""

    def __init__(self, where: str):
        super().__init__(f"out of memory on {where}: lower {_KEYS}, and go on with --resume true or begin anew")


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether an error says that memory could not be had, on a GPU or on the processor."""
    if isinstance(error, (MemoryError, torch.OutOfMemoryError)):
        return True
    return isinstance(error, RuntimeError) and any(words in str(error) for words in _OUT_OF_MEMORY)
