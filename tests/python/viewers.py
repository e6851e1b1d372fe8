"""Reads a record as public viewers do.

Each drawing must fit the type of the Foxglove SDK that its schema names, without unknown fields.

Usage: viewers.py RECORD.mcap. Prints a JSON object: the number of messages and the last message of
each channel.
"""

import json
import sys
from collections import Counter
from typing import Any

import foxglove.messages
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from mcap.reader import make_reader


def type_of(name: str) -> Any:
    """The type of the SDK, from the descriptors of the SDK."""
    schema = getattr(foxglove.messages, name.removeprefix("foxglove.")).get_schema()
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def check_fit(kind: Any, fields: dict[str, Any]) -> None:
    """Parses `fields` as the type `kind`. An unknown field is an error.

    A time has two parts in the JSON for viewers, and is a text in the JSON of protobuf.
    """
    time = fields["timestamp"]
    if not 0 <= time["nsec"] < 1_000_000_000:
        sys.exit(f"timestamp = {time}: expected nsec from 0 to 999999999")
    json_format.ParseDict({**fields, "timestamp": "1970-01-01T00:00:00Z"}, kind())


counts: Counter[str] = Counter()
last: dict[str, Any] = {}
types: dict[str, Any] = {}
with open(sys.argv[1], "rb") as file:
    for schema, channel, message in make_reader(file).iter_messages():
        fields = json.loads(message.data)
        if schema.encoding != "jsonschema" or channel.message_encoding != "json":
            sys.exit(f"{channel.topic}: {schema.encoding}, {channel.message_encoding}")
        unknown = fields.keys() - json.loads(schema.data)["properties"].keys()
        if unknown:
            sys.exit(f"{channel.topic}: fields {unknown} are not in the schema")
        if schema.name.startswith("foxglove."):
            if schema.name not in types:
                types[schema.name] = type_of(schema.name)
            check_fit(types[schema.name], fields)
        counts[channel.topic] += 1
        last[channel.topic] = fields
print(json.dumps({"counts": counts, "last": last}))
