"""A record as public viewers read it: each drawing put into the type of the Foxglove SDK that its schema names, strictly.

viewers.py RECORD.mcap. Prints a JSON object: messages and fields by channel, and what the last ones say.
"""
import json
import sys
from collections import Counter
from typing import Any

import foxglove.messages
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory
from mcap.reader import make_reader


def type_of(name: str) -> Any:
    """The SDK's own type, from its own descriptors."""
    schema = getattr(foxglove.messages, name.removeprefix("foxglove.")).get_schema()
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def fit(kind: Any, says: dict[str, Any]) -> None:
    """In JSON for viewers a time is in two parts, in that of protobuf it is a text. A field that the type does not have is an error."""
    time = says["timestamp"]
    if not 0 <= time["nsec"] < 1_000_000_000:
        sys.exit(f"{time} is no time")
    json_format.ParseDict({**says, "timestamp": "1970-01-01T00:00:00Z"}, kind())


counts: Counter[str] = Counter()
last: dict[str, Any] = {}
types: dict[str, Any] = {}
with open(sys.argv[1], "rb") as file:
    for schema, channel, message in make_reader(file).iter_messages():
        says = json.loads(message.data)
        if schema.encoding != "jsonschema" or channel.message_encoding != "json":
            sys.exit(f"{channel.topic}: {schema.encoding}, {channel.message_encoding}")
        unknown = says.keys() - json.loads(schema.data)["properties"].keys()
        if unknown:
            sys.exit(f"{channel.topic}: {unknown} are not in its schema")
        if schema.name.startswith("foxglove."):
            if schema.name not in types:
                types[schema.name] = type_of(schema.name)
            fit(types[schema.name], says)
        counts[channel.topic] += 1
        last[channel.topic] = says
print(json.dumps({"counts": counts, "last": last}))
