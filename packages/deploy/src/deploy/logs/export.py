"""A log as a rosbag2 folder, for `ros2 bag play` and tools that want metadata.yaml."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from deploy.errors import LogError
from deploy.logs.metadata import opened

_FOREVER = QosTime(2147483647, 4294967295)
LATCHED = Qos(
    history=QosHistory.KEEP_LAST,
    depth=1,
    reliability=QosReliability.RELIABLE,
    durability=QosDurability.TRANSIENT_LOCAL,
    deadline=_FOREVER,
    lifespan=_FOREVER,
    liveliness=QosLiveliness.AUTOMATIC,
    liveliness_lease_duration=_FOREVER,
    avoid_ros_namespace_conventions=False,
)
"""For what is published once: whoever subscribes later still gets it."""


def export_rosbag2(log: str | Path, folder: str | Path) -> int:
    """Write a log as a rosbag2 folder (version 9, MCAP storage).

    Messages keep their bytes and times. Attachments become files of the folder, metadata its `custom_data`.

    Args:
        log: A complete .mcap log.
        folder: Where; must not exist.

    Returns:
        The number of messages.

    Raises:
        LogError: The log is missing or damaged, or the folder exists or cannot be written.
    """
    log, folder = Path(log), Path(folder)
    if not log.is_file():
        raise LogError(f"{log}: no such log; give the .mcap that `deploy run` wrote")
    if folder.exists():
        raise LogError(f"{folder}: exists; choose another folder")
    try:
        with log.open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            attachments = list(reader.iter_attachments())
            metadata = {record.name: opened(record.metadata) for record in reader.iter_metadata()}
        messages = _copy(log, folder, metadata)
        for attachment in attachments:
            (folder / Path(attachment.name).name).write_bytes(attachment.data)
    except Exception as error:  # on torn bytes the readers raise whatever their parsing meets
        shutil.rmtree(folder, ignore_errors=True)
        raise LogError(
            f"{log}: cannot export ({type(error).__name__}: {error}); "
            f"if the log is damaged, `deploy recover {log}` first"
        ) from error
    return messages


def _copy(log: Path, folder: Path, metadata: dict[str, dict[str, object] | None]) -> int:
    messages = 0
    with AnyReader([log]) as reader, Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for name, values in metadata.items():
            bag.set_custom_data(name, json.dumps(values))
        store = get_typestore(Stores.ROS2_HUMBLE)
        store.register({name: fields for name, fields in reader.typestore.fielddefs.items() if name not in store.types})
        channels = {
            connection.id: bag.add_connection(
                connection.topic,
                connection.msgtype,
                typestore=store,
                offered_qos_profiles=[LATCHED] if connection.topic == "/robot_description" else (),
            )
            for connection in reader.connections
        }
        for connection, time, data in reader.messages():
            bag.write(channels[connection.id], time, data)
            messages += 1
    return messages
