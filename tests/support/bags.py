"""Bags that a writer of rosbags has filled with (topic, type, ns, message)."""

from sean_jax.ros import messages


def write_bag1(path, rows, compression=None):
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    return fill(writer, path, rows, 1)


def write_bag2(path, rows, plugin="MCAP"):
    from rosbags.rosbag2 import StoragePlugin, Writer

    return fill(Writer(path, version=9, storage_plugin=StoragePlugin[plugin]), path, rows, 2)


def fill(writer, path, rows, version):
    """Write the rows by a writer of rosbags; return the path of the bag."""
    store, connections = messages.typestore(version), {}
    serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with writer:
        for topic, kind, time, message in rows:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], time, serialize(messages.fill(store, kind, message), kind))
    return path
