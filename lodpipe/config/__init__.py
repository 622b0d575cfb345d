"""Configurations: YAML in, checked parameters out, and a clear line for whatever is wrong."""
