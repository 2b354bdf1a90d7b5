"""nerf-rl: perception-first robot learning on MuJoCo."""

from nerf_rl.machine.gl import set_default_backend

__version__ = "0.1.0"

set_default_backend()
