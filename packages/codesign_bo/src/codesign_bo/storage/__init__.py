"""Durable trials: one SQLite file, one writer, every step committed before the next begins."""

from codesign_bo.storage.schema import SCHEMA_VERSION, SEARCH
from codesign_bo.storage.tables import Dispatch, Storage

__all__ = ["SCHEMA_VERSION", "SEARCH", "Dispatch", "Storage"]
