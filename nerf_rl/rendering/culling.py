"""Which geoms a camera cannot see, by their bounding boxes, and which are seen through: what need not be drawn."""

import mujoco
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray

from nerf_rl.cameras.geometry import camera_position
from nerf_rl.scenes.workspace import opacity, undrawn

_ZERO = 1e-9
_FAINT = 0.5  # of a mark's opacity, below which it is seen through
_SLACK = 1.02  # of the boxes: simplified meshes may stand out of the original's box a little
_KIND = mujoco.mjtGeom
_EXTENTS = {
    _KIND.mjGEOM_SPHERE: [[1, 0, 0], [1, 0, 0], [1, 0, 0]],
    _KIND.mjGEOM_CAPSULE: [[1, 0, 0], [1, 0, 0], [1, 1, 0]],
    _KIND.mjGEOM_CYLINDER: [[1, 0, 0], [1, 0, 0], [0, 1, 0]],
    _KIND.mjGEOM_ELLIPSOID: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    _KIND.mjGEOM_BOX: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
}  # from a shape's sizes to half of its box's sides; boxes of others are those of when the model was compiled


class FrustumCulling:
    """Tests the oriented bounding boxes of a model's geoms against cameras' fields of view, all at once.

    Args:
        model: sizes, and boxes of meshes and the like, are read from it at each call.
        height, width: of an image [pixels].
        near: distance of the near plane [m].
    """

    def __init__(self, model: mujoco.MjModel, height: int, width: int, near: float):
        self._model, self._near = model, near
        self._extents = np.array([_EXTENTS.get(kind, np.zeros((3, 3))) for kind in model.geom_type]).reshape(-1, 3, 3)
        self._has_extents = np.isin(model.geom_type, list(_EXTENTS))[:, None]
        self._corner_pixels = 0.5 * np.array([[-width, -height], [width, -height], [width, height], [-width, height]])

    def outside(
        self, data: mujoco.MjData, intrinsics: Float[ndarray, "V 3 3"], camera_from_world: Float[ndarray, "V 4 4"]
    ) -> Bool[ndarray, "V G"]:
        """Tell which geoms are not drawn: those wholly outside a view or nearer than its near plane, and the undrawn.

        A view is a cone of four edges from the camera. Two convex bodies are apart if, and only if, a plane parallel to
        a face of either or to an edge of each separates them (Gottschalk et al., "OBBTree", 1996); one that separates a
        cone passes through its apex.
        """
        model = self._model
        result = np.broadcast_to(undrawn(model), (len(intrinsics), model.ngeom)).copy()
        tested = np.flatnonzero((model.geom_rbound > 0) & ~result[0])  # planes have no bounds and are always drawn
        by_size = (self._extents @ model.geom_size[..., None])[..., 0]
        half = _SLACK * np.where(self._has_extents, by_size, model.geom_aabb[:, 3:])[tested]
        world_from_box = data.geom_xmat[tested].reshape(-1, 3, 3)
        centre = data.geom_xpos[tested] + (world_from_box @ model.geom_aabb[tested, :3, None])[..., 0]

        rotation, translation = camera_from_world[:, None, :3, :3], camera_from_world[:, None, :3, 3]
        centre = (rotation @ centre[..., None])[..., 0] + translation  # [V, G, 3] in the camera's frame, as all below
        box = (rotation @ world_from_box).swapaxes(-1, -2)  # [V, G, 3 axes, 3]
        edges = np.ones((len(intrinsics), 4, 3))
        edges[..., :2] = self._corner_pixels / intrinsics[:, None, [0, 1], [0, 1]]

        sides = _cross(edges, np.roll(edges, -1, axis=1))[:, None]
        away = _apart(np.broadcast_to(sides, (*box.shape[:2], 4, 3)), centre, box, half, edges[:, None])
        away |= centre[..., 2] + (np.abs(box[..., 2]) * half).sum(-1) < self._near
        is_mesh = model.geom_type[tested] == mujoco.mjtGeom.mjGEOM_MESH
        view, geom = np.nonzero(~away & is_mesh)  # for a closer look; other shapes are drawn sooner than tested
        box, edges = box[view, geom], edges[view]
        across = _cross(edges[:, :, None], box[:, None]).reshape(-1, 12, 3)
        away[view, geom] = _apart(np.concatenate([box, across], 1), centre[view, geom], box, half[geom], edges)
        result[:, tested] = away
        return result


def faint_markers(model: mujoco.MjModel) -> Bool[ndarray, "G"]:
    """Tell which geoms are marks for people, through which everything is seen: they have no label and no depth.

    The axes, two metres long, of the mocap body that leads Fetch's hand hardly show in a picture, but would cut its
    depth and its labels in pieces. Marks belong to a mocap body, touch nothing and are less than half opaque.
    """
    leads = model.body_mocapid[model.body_rootid[model.geom_bodyid]] >= 0
    touches = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    return leads & ~touches & (opacity(model) < _FAINT)


def planes_from_behind(
    model: mujoco.MjModel, data: mujoco.MjData, camera_from_world: Float[ndarray, "V 4 4"]
) -> Bool[ndarray, "V G"]:
    """Tell which geoms are planes whose back a camera looks at, where MuJoCo's rays do not hit them."""
    normals = data.geom_xmat.reshape(-1, 3, 3)[..., 2]
    above = ((camera_position(camera_from_world)[:, None] - data.geom_xpos) * normals).sum(-1)
    return (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE) & (above < 0)


def _apart(
    normals: Float[ndarray, "*B A 3"],
    centre: Float[ndarray, "*B 3"],
    box: Float[ndarray, "*B 3 3"],
    half: Float[ndarray, "*#B 3"],
    edges: Float[ndarray, "*#B 4 3"],
) -> Bool[ndarray, "*B"]:
    """Tell whether a plane through the camera with one of the normals has a box on one side and the view on the other.

    Args:
        normals: to try.
        centre, box, half: of the box; its axes are rows.
        edges: of the view.
    """
    middle = (normals @ centre[..., None])[..., 0]
    reach = (np.abs(normals @ box.swapaxes(-1, -2)) @ half[..., None])[..., 0]
    cone = normals @ edges.swapaxes(-1, -2)
    above, below = (cone > -_ZERO).all(-1), (cone < _ZERO).all(-1)
    return ((above & (middle < -reach)) | (below & (middle > reach))).any(-1)


def _cross(a: Float[ndarray, "*#B 3"], b: Float[ndarray, "*#B 3"]) -> Float[ndarray, "*#B 3"]:
    """Return the cross product; :func:`numpy.cross` takes longer for so few vectors."""
    ahead, behind = [1, 2, 0], [2, 0, 1]
    return a[..., ahead] * b[..., behind] - a[..., behind] * b[..., ahead]
