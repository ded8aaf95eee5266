"""Clips from scenes: a deferred renderer with exact buffers. `scene.py` is what it draws, `make.py` what it writes."""

from framecast.render.make import Settings, listing, load, render_clip

__all__ = ["Settings", "listing", "load", "render_clip"]
