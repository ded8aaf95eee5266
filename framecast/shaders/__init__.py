"""WGSL, one pass per file. Files without an entry point hold functions that several passes share."""
