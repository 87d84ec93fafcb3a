"""Tables of a study file.

- `trials`: proposals, committed before they are dispatched.
- `evaluations`: what is to be evaluated and its settled result, at most one each. Those with `repeat` -1
  are the search's own; from 0 on they are confirmation runs.
- `attempts`: each dispatch of an evaluation, with the token that fences it and whatever was told of it.
- `queue`, `screening`: designs of the user, and cheap scores that help to choose among them.
- `history`: evaluations of other studies, for the surrogate alone.
"""

from __future__ import annotations

import sqlite3

SCHEMA_VERSION = 2

SEARCH = -1
"""The `repeat` of a trial's evaluation in the search."""

_TABLES = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE trials (
    trial INTEGER PRIMARY KEY, params TEXT NOT NULL, origin TEXT NOT NULL, fidelity REAL NOT NULL, basis TEXT);
CREATE TABLE evaluations (
    trial INTEGER NOT NULL REFERENCES trials, repeat INTEGER NOT NULL, seed INTEGER NOT NULL, result TEXT,
    PRIMARY KEY (trial, repeat));
CREATE TABLE attempts (
    token TEXT PRIMARY KEY, trial INTEGER NOT NULL, repeat INTEGER NOT NULL, attempt INTEGER NOT NULL,
    status TEXT NOT NULL, started REAL, ended REAL, seconds REAL, deadline REAL, message TEXT NOT NULL,
    result TEXT, final INTEGER NOT NULL, closed INTEGER NOT NULL,
    UNIQUE (trial, repeat, attempt), FOREIGN KEY (trial, repeat) REFERENCES evaluations);
CREATE TABLE queue (
    position INTEGER PRIMARY KEY, params TEXT NOT NULL UNIQUE, trial INTEGER REFERENCES trials);
CREATE TABLE screening (
    position INTEGER PRIMARY KEY, params TEXT NOT NULL UNIQUE, value REAL NOT NULL, sem REAL);
CREATE TABLE history (
    position INTEGER PRIMARY KEY, source TEXT NOT NULL, trial INTEGER NOT NULL, params TEXT NOT NULL,
    result TEXT NOT NULL, UNIQUE (source, trial));
"""


def create(db: sqlite3.Connection) -> None:
    """Make all tables, within the caller's transaction."""
    for statement in _TABLES.split(";\n"):
        db.execute(statement)
