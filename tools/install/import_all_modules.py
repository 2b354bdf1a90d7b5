"""Import every module of the installed nerf_rl with its array annotations switched on; name the package's folder.

A module missing from a wheel, an annotation that jaxtyping cannot read and a forgotten dependency all show here.
"""

import importlib
import pkgutil

from jaxtyping import install_import_hook


def main() -> None:
    """Import all modules."""
    with install_import_hook("nerf_rl", "beartype.beartype"):
        package = importlib.import_module("nerf_rl")
        names = [module.name for module in pkgutil.walk_packages(package.__path__, "nerf_rl.")]
        for name in names:
            importlib.import_module(name)
    print(f"imported {len(names)} modules from {package.__path__[0]}")


if __name__ == "__main__":
    main()
