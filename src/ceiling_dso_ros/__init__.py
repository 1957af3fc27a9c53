"""Ceiling visual odometry for indoor industrial robots: Direct Sparse Odometry and wheel fusion."""

from pkgutil import extend_path

# catkin's devel space has a second folder of this package: the generated msg and cfg.
__path__ = extend_path(__path__, __name__)

__version__ = "0.1.0"
