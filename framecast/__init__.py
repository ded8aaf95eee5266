"""framecast: more pixels and more frames than were shaded."""

__version__ = "0.1.0"
