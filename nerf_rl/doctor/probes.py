"""What ``nerf-rl doctor`` tries out, each in a process of its own, since drivers and compiled code may crash or hang.

Run as ``python -m nerf_rl.doctor.probes NAME``; the last line of output is JSON.
"""

import json
import sys

_SCENE = """
<mujoco>
  <statistic extent="2" center="0 0 0"/>
  <worldbody>
    <light pos="0 0 3" dir="0 0 -1"/>
    <geom type="plane" size="5 5 0.1" rgba="0.3 0.4 0.5 1"/>
    <geom type="sphere" pos="0 0 0.2" size="0.2" rgba="0.9 0.1 0.1 1"/>
  </worldbody>
</mujoco>
"""
_SIZE = 32


def rendering() -> dict[str, str]:
    """Render a small scene with the backend in ``MUJOCO_GL``; return the OpenGL implementation's name for itself.

    Raises:
        RuntimeError: pixels, labels or depth are wrong.
    """
    import mujoco
    import numpy as np

    from nerf_rl.cameras.geometry import intrinsics_from_fovy, look_at
    from nerf_rl.rendering.renderer import MultiViewRenderer

    model = mujoco.MjModel.from_xml_string(_SCENE)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = MultiViewRenderer(model, _SIZE, _SIZE, 1)
    pose = look_at(np.array([0.0, 0.0, 0.2]), 1.2, 90.0, -45.0)
    views = renderer.render(data, intrinsics_from_fovy(45.0, _SIZE, _SIZE)[None], pose[None])
    middle = (0, _SIZE // 2, _SIZE // 2)
    red, green, blue = (int(value) for value in views.rgb[middle])
    if views.geom[middle] != 1 or views.geom[0, 0, 0] != 0:
        raise RuntimeError("labels are wrong")
    if not red > 2 * max(green, blue):
        raise RuntimeError(f"a red ball has the colour {red}, {green}, {blue}")
    if abs(float(views.depth[middle]) - 1.0) > 0.01:
        raise RuntimeError(f"a ball at 1 m has the depth {views.depth[middle]:.3f} m")
    name = renderer.gl_renderer
    renderer.close()
    return {"renderer": name}


def torch() -> dict[str, str]:
    """Draw a batch with TorchRL's prioritised sampler, whose compiled part loads only beside the torch it is for."""
    import torch as installed_torch
    import torchrl
    from torchrl.data import LazyTensorStorage, ReplayBuffer
    from torchrl.data.replay_buffers.samplers import PrioritizedSampler

    buffer = ReplayBuffer(
        storage=LazyTensorStorage(8), sampler=PrioritizedSampler(8, alpha=0.6, beta=0.4), batch_size=4
    )
    buffer.extend(installed_torch.arange(8.0))
    if len(buffer.sample()) != 4:
        raise RuntimeError("the prioritised sampler drew a batch of the wrong size")
    if installed_torch.cuda.is_available():
        device = installed_torch.cuda.get_device_name(0)
    else:
        device = f"no GPU, {installed_torch.get_num_threads()} threads"
    return {"torch": installed_torch.__version__, "torchrl": torchrl.__version__, "device": device}


def export() -> dict[str, str]:
    """Import Open3D with the system libraries that it needs."""
    from nerf_rl.datasets.export.mesh import load_open3d

    return {"version": load_open3d().__version__}


PROBES = {"rendering": rendering, "torch": torch, "export": export}


def main() -> None:
    """Run a probe and print what it returns, or what went wrong."""
    try:
        result = {"ok": True, **PROBES[sys.argv[1]]()}
    except BaseException as error:
        result = {"ok": False, "error": " ".join(f"{type(error).__name__}: {error}".split())}
    print(json.dumps(result), flush=True)


if __name__ == "__main__":
    main()
