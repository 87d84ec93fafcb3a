"""Where a study file must not lie: SQLite's locks and write-ahead log need a local disk."""

from __future__ import annotations

import re
from pathlib import Path

from codesign_bo.errors import StudyError

_MOUNTS = Path("/proc/self/mounts")
_NETWORK = re.compile(
    r"(nfs\d*|cifs|smb\d*|smbfs|ncpfs|afs|coda|davfs|lustre|gpfs|beegfs\w*|ceph|glusterfs|orangefs|pvfs2|panfs|wekafs"
    r"|gfs2|ocfs2|fuse\.(sshfs|glusterfs\w*|ceph\w*|s3fs|gcsfuse|rclone|davfs2?|lizardfs|mfs\w*|curlftpfs))$"
)


def network_mount(path: Path, mounts: Path = _MOUNTS) -> str | None:
    """Return the kind and place of the network file system that a path lies on, as `nfs4 at /home`, or None.

    Args:
        path: File or folder, which need not exist; links are followed.
        mounts: Table of mounts, as Linux lists them; where there is none, nothing is known.
    """
    if not mounts.is_file():
        return None
    kind, where = "", Path()
    target = path.resolve()
    for line in mounts.read_text(errors="replace").splitlines():
        _, point, filesystem, *_ = line.split(" ")
        mount = Path(re.sub(r"\\(\d{3})", lambda code: chr(int(code[1], 8)), point))
        # Of mounts on the same point the last one counts.
        if target.is_relative_to(mount) and len(mount.parts) >= len(where.parts):
            kind, where = filesystem, mount
    return f"{kind} at {where}" if _NETWORK.match(kind) else None


def refuse_network(path: Path, mounts: Path = _MOUNTS) -> None:
    """Refuse a path on a network file system (see `network_mount`).

    Raises:
        StudyError: The path lies on a network file system.
    """
    found = network_mount(path, mounts)
    if found is not None:
        raise StudyError(
            f"{path} lies on a network file system ({found}), where SQLite may lose or damage trials; "
            "put the study on a local disk (the work folders of evaluations may stay, see `workdir`), or pass "
            "allow_network=True if you know that its locks work and only this machine uses it"
        )
