"""The processes that joblib hands work to: on this machine by loky, on a cluster by Ray.

Both are processes even if there is one worker only, because a process can be ended and replaced when it hangs, and this
one cannot. OpenGL contexts do not survive a fork; loky and Ray start processes afresh.
"""

import os
from typing import Any

from joblib._parallel_backends import LokyBackend, ParallelBackendBase
from joblib.executor import get_memmapping_executor
from joblib.externals.loky.process_executor import BrokenProcessPool

from nerf_rl.errors import UserError
from nerf_rl.machine.extras import import_extra
from nerf_rl.machine.processes import ignore_sigint, start_worker


class LocalProcesses(LokyBackend):
    """joblib's loky backend, whose processes are ended with the work and are not left to idle."""

    def configure(
        self, n_jobs: int = 1, parallel: Any = None, prefer: Any = None, require: Any = None, **options: Any
    ) -> int:
        """Start ``n_jobs`` processes."""
        self._workers = get_memmapping_executor(
            n_jobs, env=self._prepare_worker_env(n_jobs), initializer=start_worker, context_id=parallel._id
        )
        with ignore_sigint():
            self._workers.submit(int)  # the first task is what starts the processes
        self.parallel = parallel
        return max(n_jobs, 2)  # joblib would take one job as none of its own process

    def terminate(self) -> None:
        """End the processes."""
        if self._workers is not None:
            self._workers.terminate()
            self._workers = None
        self.reset_batch_stats()


def open_backend(name: str) -> tuple[ParallelBackendBase, tuple[type[Exception], ...]]:
    """Return the joblib backend, and the errors by which it tells that a process died.

    Args:
        name: ``loky`` or ``ray``.

    Raises:
        UserError: Ray is not installed or no cluster answers.
    """
    if name == "loky":
        return LocalProcesses(), (BrokenProcessPool,)
    return _connect_to_ray()


def _connect_to_ray() -> tuple[ParallelBackendBase, tuple[type[Exception], ...]]:
    ray = import_extra("ray", "ray", "--backend ray")
    from ray.util.joblib.ray_backend import RayBackend

    class RayProcesses(RayBackend):
        """Ray's joblib backend, which hands results over as they come."""

        supports_return_generator = True

    if not ray.is_initialized():
        address = os.environ.get("RAY_ADDRESS", "auto")
        try:
            ray.init(address=address, log_to_driver=False, logging_level="ERROR")
        except ConnectionError as error:
            raise UserError(
                f"no Ray cluster answers at '{address}'; start one with ray start --head, or set RAY_ADDRESS"
            ) from error
    return RayProcesses(), (ray.exceptions.RayError,)
