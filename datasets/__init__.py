"""What a scene, a material and a trajectory are, and how they are read and written."""

__version__ = "0.1.0"
