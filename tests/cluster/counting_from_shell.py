"""``counting`` as a program."""

from recipes.shell import start
from tests.cluster.counting import main

if __name__ == "__main__":
    start(main)
