"""The core of the iCub perception-and-grasping framework: interfaces, data, registry, composition.

Importing this package is cheap on purpose: no numpy, no torch, no engine. Pick the submodule you need.
"""

__version__ = "0.1.0"
