"""What the results of evaluations look like in the files that keep them."""

from nerf_rl.files.structure import listing, mapping, number, whole

EVALUATIONS = listing(
    mapping(
        {
            "env_steps": whole(),
            "episodes": whole(1),
            **dict.fromkeys(("success_rate", "ci_low", "ci_high"), number(0.0, 1.0)),
            "mean_return": number(),
        },
        others=True,
    )
)
"""of training, oldest first, as in ``summary.json`` and in checkpoints"""
