"""What validation says of classes that the field does not show."""

from nerf_rl.pretrain.measures.figures import describe_hardly_shown, hardly_shown


def test_a_visible_class_of_low_iou_is_named_and_others_are_not():
    iou = {"background": 0.97, "faucet": 0.41, "handle": 0.03, "screw": 0.0, "hidden": None}
    share = {"background": 0.9, "faucet": 0.02, "handle": 0.01, "screw": 0.0005, "hidden": 0.0}
    assert hardly_shown(iou, share) == ["handle"]
    assert describe_hardly_shown(["handle"], iou).startswith("the field hardly shows handle (IoU 0.03): ")
