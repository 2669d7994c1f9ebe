"""What pyproject.toml cannot say: the recipes are installed as ``zfall.recipes``."""

from setuptools import find_packages, setup

RECIPES = ["zfall.recipes", *(f"zfall.recipes.{name}" for name in find_packages("recipes"))]

setup(
    packages=[*find_packages(include=["zfall", "zfall.*"]), *RECIPES],
    package_dir={"zfall.recipes": "recipes"},
    package_data={
        "zfall": ["py.typed"],
        "zfall.cluster": ["*.yaml", "plugins/hydra_plugins/*.py"],
        "zfall.robots": ["assets/*"],
        "zfall.falling": ["assets/*"],
        "zfall.evaluation": ["*.j2"],
        "zfall.policies": ["*.pt", "*.md"],
        "zfall.recipes": ["**/*.yaml"],
    },
)
