"""Textured 3-D models in, folders of LODs and a report out."""
