"""Prints what pyproject.toml needs, with the extras named as arguments; requirements.lock says which versions."""

import sys
import tomllib

with open("pyproject.toml", "rb") as file:
    project = tomllib.load(file)["project"]
print(*project["dependencies"], *(need for extra in sys.argv[1:] for need in project["optional-dependencies"][extra]))
