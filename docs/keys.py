#!/usr/bin/env python3
"""Writes docs/reference/settings.md: every key of the files that `coxswain launch` reads.

Usage: python3 docs/keys.py [--check]

The source is the Rust code that reads the files: the fields with their doc comments, the defaults
of serde, and the texts of the checks. With --check it writes nothing, and fails if the page is old.
It also fails if a file below deploy/ has a key that the page has not. rustfmt keeps the code
regular.
"""

import pathlib
import re
import sys
import textwrap
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/reference/settings.md"
FILES = [
    ("Graph file", "services/graph/src/file.rs", "Graph", "deploy/graphs"),
    ("Robot file", "services/robot/src/robot.rs", "Robot", "deploy/robots"),
    ("Map file", "services/robot/src/map.rs", "Map", "deploy/maps"),
    ("Scenario file", "services/graph/src/scenario.rs", "Scenario", "deploy/scenarios"),
    ("File of faults", "services/graph/src/faults.rs", "FaultsFile", "deploy/faults"),
]
PLAIN = {"String", "PathBuf", "bool", "char"} | {f"{s}{n}" for s in "iuf" for n in (8, 16, 32, 64)}
PLAIN |= {"usize", "isize"}


class Item:
    """A struct or an enum that is read from a file."""

    def __init__(self, file, text, found):
        self.file, self.name, self.is_enum = file, found["name"], found["kind"] == "enum"
        self.attributes, self.docs = found["head"], doc_text(found["head"])
        self.entries = entries(found["body"], self.is_enum)
        self.source = text


def doc_text(head):
    """First paragraph of a doc comment, as plain text."""
    lines = [
        line.strip()[3:].strip() for line in head.splitlines() if line.strip().startswith("///")
    ]
    text = " ".join(lines[: lines.index("")] if "" in lines else lines)
    return re.sub(
        r"\[`?([^\]`]+)`?\](\([^)]*\))?(?<!\\\])",
        r"\1",
        text.replace("\\[", "⟦").replace("\\]", "⟧"),
    )


def entries(body, is_enum):
    """(head, name, type or content) of each field or variant."""
    found, head, deep, rest = [], [], 0, body.splitlines()
    for line in rest:
        stripped = line.strip()
        if deep == 0 and (stripped.startswith(("///", "#["))):
            head.append(stripped)
        elif deep == 0 and stripped:
            pattern = r"(\w+)(.*)" if is_enum else r"(?:pub(?:\([^)]*\))? )?(\w+): (.*)"
            if match := re.match(pattern, stripped):
                content = match[2].rstrip(",").strip()
                found.append(["\n".join(head), match[1], content])
                head = []
        elif deep > 0 and found:
            found[-1][2] += "\n" + line
        deep += line.count("{") + line.count("(") - line.count("}") - line.count(")")
    return found


def items():
    """All items by (file, name)."""
    pattern = re.compile(
        r"^(?P<head>(?:(?:///.*|#\[.*)\n)+)"
        r"pub(?:\([^)]*\))? (?P<kind>struct|enum) (?P<name>\w+) \{\n"
        r"(?P<body>[\s\S]*?)^\}",
        re.M,
    )
    found = {}
    for folder in ("services", "plant-sim"):
        for path in sorted((ROOT / folder).glob("**/src/**/*.rs")):
            text = path.read_text()
            for match in pattern.finditer(text):
                if "Deserialize" in match["head"]:
                    item = Item(path, text, match)
                    found[path, item.name] = item
    return found


def resolve(name, near, all_items):
    """The item of this name that the code of `near` means, or the one that it is read as."""
    found = meant(name, near, all_items)
    read_as = found and re.search(r'try_from = "(\w+)"', found.attributes)
    # What only an error needs is private.
    return (read_as and resolve(read_as[1], found, all_items)) or found


def meant(name, near, all_items):
    own = all_items.get((near.file, name))
    candidates = [item for (_, other), item in all_items.items() if other == name]
    if own or len(candidates) <= 1:
        return own or (candidates[0] if candidates else None)
    crate = lambda item: item.file.relative_to(ROOT).parts[
        -3 if item.file.parent.name == "src" else -4
    ]
    for use in re.findall(r"^use (.*?);", near.source, re.M | re.S):
        if re.search(rf"\b{name}\b", use):
            begin = use.split("::")[0]
            of_crate = [
                c
                for c in candidates
                if c.file.relative_to(ROOT).parts.count(begin.replace("_", "-"))
            ]
            if len(of_crate) == 1:
                return of_crate[0]
    same = [
        c
        for c in candidates
        if c.file.relative_to(ROOT).parts[:2] == near.file.relative_to(ROOT).parts[:2]
    ]
    return (
        same[0]
        if len(same) == 1
        else sys.exit(f"{name} in {near.file}: {len(candidates)} meanings")
    )


def kebab(name):
    return re.sub(r"(?<!^)(?=[A-Z])", "-", name).lower()


def unit(docs):
    """The text without its unit, and the unit."""
    found = re.findall(r"⟦([^⟧]*)⟧", docs)
    text = re.sub(r" ?⟦[^⟧]*⟧", "", docs)
    return text, ", ".join(found)


def literal(value):
    """A Rust literal as in TOML."""
    value = (
        value.strip().replace("_", "")
        if re.fullmatch(r"[-\d_.e]+", value.strip())
        else value.strip()
    )
    value = re.sub(
        r"^\[\[?([\d.]+); (\d+)\]$", lambda m: f"[{', '.join([m[1]] * int(m[2]))}]", value
    )
    value = re.sub(r"^vec!\[(.*)\]$", r"[\1]", value.replace(".to_owned()", ""))
    return {"None": "none", "Vec::new()": "empty", "String::new()": '""'}.get(value, value)


def default_of_type(kind, near, all_items):
    if kind.startswith("Option<"):
        return "none"
    if kind.startswith(("Vec<", "BTreeMap<")):
        return "empty"
    if kind == "bool":
        return "false"
    if array := re.match(r"\[(\w+); (\d+)\]", kind):
        return f"[{', '.join([default_of_type(array[1], near, all_items)] * int(array[2]))}]"
    if kind == "toml::Table":
        return "empty"
    if kind in PLAIN:
        return "0" if kind[0] in "iu" else "0.0" if kind[0] == "f" else '""'
    item = resolve(kind, near, all_items)
    if item and item.is_enum:
        for head, name, _ in item.entries:
            if "#[default]" in head:
                return spelling(item, head, name)
    if not item:
        return "see text"
    return (
        "all optional"
        if all(field[3] != "**required**" for field in fields(item, all_items))
        else "see text"
    )


def spelling(item, head, name):
    """A variant as it is written in a file."""
    if renamed := re.search(r'rename = "([^"]+)"', head):
        return renamed[1]
    return (
        kebab(name)
        if "kebab-case" in item.attributes
        else name.lower() if "lowercase" in item.attributes else name
    )


def expected(item, name):
    """What the checks beside an item expect of its key."""
    texts = []
    patterns = [
        rf'Impossible::new\(\s*"(?:[\w.]+\.)?{name}",\s*(?:format!\()?\s*"((?:[^"\\]|\\.)*)"',
        rf'Impossible \{{\s*key: "(?:[\w.]+\.)?{name}"(?:\.into\(\))?,\s*'
        r'expected: (?:format!\()?"((?:[^"\\]|\\.)*)"',
        rf'impossible\(\s*"(?:[\w.]+\.)?{name}",\s*&?(?:format!\(\s*)?"((?:[^"\\]|\\.)*)"',
    ]
    for pattern in patterns:
        texts += re.findall(pattern, item.source)
    for table, rest in tables(item.source):
        if re.search(rf'"(?:[\w.]+\.)?{name}"', table):
            texts += re.findall(
                r'(?:expected(?::| =) (?:format!\()?|impossible\(key, )"((?:[^"\\]|\\.)*)"', rest
            )[:1]
    text = re.sub(r"\\\n\s*", "", texts[0]).replace(" = {}", "") if texts else ""
    messages = "".join(path.read_text() for path in (ROOT / "protocol/src").glob("message/*.rs"))
    constants = dict(
        re.findall(r"const (\w+): [\w:]+ = ([-\d_.e]+);", messages + item.source)
    )
    filled = re.sub(r"\{(\w+)\}", lambda m: constants.get(m[1], "{").replace("_", ""), text)
    return "" if "{" in filled else filled.replace('\\"', '"')


def tables(source):
    """Lists of ("key", value) rows, and the code after each."""
    lines, begin = source.splitlines(), None
    for number, line in enumerate(lines):
        is_row = re.match(r'\s+\("[\w.]+", .*\),$', line)
        if is_row and begin is None:
            begin = number
        elif not is_row and begin is not None:
            rest = "\n".join(lines[number : number + 14])
            if named := re.search(r"(\w+)(?: = vec!|\.extend\()\[$", lines[begin - 1]):
                rest = source[source.index(f" in {named[1]} {{") :]
            yield "\n".join(lines[begin:number]), rest
            begin = None


def fields(item, all_items):
    """(name, type, unit, default, text) of each key of a struct."""
    by_container = "serde(default" in item.attributes.replace("#[", "")
    given = re.search(rf"impl Default for {item.name} \{{.*?\n\}}", item.source, re.S)
    body = re.search(r"Self \{(?! enabled)([^{}]*)\}", given[0]) if given else None
    values = (
        dict(re.findall(r"(\w+): ([^\n]*?)(?:,\n|, (?=\w+: )| ?$)", body[1].strip()))
        if body
        else {}
    )
    rows = []
    for head, name, kind in item.entries:
        if "serde(skip)" in head or "The launcher sets it." in head:
            continue
        kind = " ".join(kind.split())
        function = re.search(r'default = "(\w+)"', head)
        if function:
            body = re.search(rf"fn {function[1]}\(\)[^{{]*\{{\s*(.*?)\s*\}}", item.source, re.S)
            default = literal(body[1]) if body else "see text"
        elif by_container and name in values:
            default = literal(values[name].rstrip(","))
            if "started" in default:
                default = "not enabled" if "not_started" in default else "all optional"
            elif "::" in default:
                default = default_of_type(kind, item, all_items)
        elif by_container or "serde(default" in head:
            default = default_of_type(kind, item, all_items)
        elif kind.startswith("Option<"):
            default = "none"
        else:
            default = "**required**"
        text, of = unit(doc_text(head))
        demand = expected(item, name)
        if demand:
            text += f" Expected: {demand}."
        rows.append((name, kind, of, default, text))
    return rows


def inner(kind):
    """The types in a type, and its name on the page."""
    kind = re.sub(r"\bWheelList\b", "Vec<Wheel>", re.sub(r"\bVelocity\b", "[f64; 3]", kind))
    names = [
        name
        for name in re.findall(r"[A-Za-z_]\w*", kind)
        if name not in ("Option", "Vec", "BTreeMap")
    ]
    shown = (
        re.sub(r"Option<(.*)>", r"\1", kind)
        .replace("toml::Table", "table")
        .replace("PathBuf", "path")
        .replace("String", "text")
    )
    shown = re.sub(r"Vec<(.*)>", r"list of \1", shown)
    shown = re.sub(r"BTreeMap<(\w+), (.*)>", r"table of \2", shown)
    shown = re.sub(r"\b[iu]\d+\b|\busize\b", "integer", shown)
    return names, re.sub(r"\bf64\b", "number", shown)


def escape(text):
    return text.replace("|", "\\|").replace("<", "&lt;").strip()


def anchor(item, title):
    return f"{kebab(title.split()[0])}-{kebab(item.name)}"


def chapter(title, file, root, folder, all_items, constants):
    """The chapter of one kind of file: a table for each table of keys."""
    lines = ["", f"## {title}", "", f"Examples are in [{folder}](../../{folder}).", ""]
    waiting, done = [(all_items[ROOT / file, root], "")], set()
    while waiting:
        item, path = waiting.pop(0)
        if item in done:
            continue
        done.add(item)
        if path:
            lines += [f"### {title.split()[0]}: {path}", ""]
        if item.docs and path:
            lines += [textwrap.fill(escape(unit(item.docs)[0]), 100), ""]
        if item.is_enum:
            lines += ["| value | meaning |", "|---|---|"]
            for head, name, content in item.entries:
                keys = re.findall(r"^\s+(\w+): ([^,\n]+),$", content, re.M)
                text, of = unit(doc_text(head))
                more = f" Keys: {', '.join(f'`{key}`' for key, _ in keys)}." if keys else ""
                value = spelling(item, head, name)
                if re.match(r"\((.*)\)", content):
                    value += f" = {inner(content[1:-1])[1]}"
                lines.append(f"| `{value}` | {escape(text)}{f' [{of}]' if of else ''}{more} |")
                waiting += [
                    (found, f"{value}")
                    for name in inner(content)[0]
                    if (found := resolve(name, item, all_items))
                ]
            lines.append("")
            continue
        lines += ["| key | type | unit | default | meaning |", "|---|---|---|---|---|"]
        for name, kind, of, default, text in fields(item, all_items):
            names, shown = inner(kind)
            known = lambda match: constants.get(match[1], match[0])
            default = re.sub(r"\b([A-Z][A-Z_]+)\b", known, default)
            text = re.sub(r"\b\w+::([A-Z_]+)\b", known, text)
            lines.append(
                f"| `{name}` | {escape(shown)} | {of} | {escape(default)} | {escape(text)} |"
            )
            for other in names:
                if other not in PLAIN and (found := resolve(other, item, all_items)):
                    waiting.append((found, f"{path}.{name}".strip(".")))
        lines.append("")
    return lines[:-1]


def keys_in(table):
    """Names of the keys of a file; what is below `hosts` and `settings` has free names."""
    for key, value in table.items():
        yield key
        if isinstance(value, dict) and key != "settings":
            inside = value.values() if key == "hosts" else [value]
            for each in inside:
                yield from keys_in(each)
        elif isinstance(value, list):
            for each in value:
                if isinstance(each, dict):
                    yield from keys_in(each)


def missing(text):
    """Keys of the files that ship which the page does not have."""
    found = []
    for _, _, _, folder in FILES:
        for file in sorted((ROOT / folder).glob("**/*.toml")):
            known = lambda key: f"`{key}`" in text or f"`{key} =" in text
            keys = keys_in(tomllib.loads(file.read_text()))
            found += [f"{file.relative_to(ROOT)}: {key}" for key in keys if not known(key)]
    return found


def main():
    all_items = items()
    constants = {}
    for item in all_items.values():
        value = r'([-\d_.e]+|"[^"]*")'
        constants |= dict(re.findall(rf"const (\w+): [&\w:]+ = {value};", item.source))
    lines = [
        "# Settings",
        "",
        "This page lists every key of the files that `coxswain launch` reads. It is for everyone",
        "who writes one. `python3 docs/keys.py` writes it from the code; do not edit it.",
        "",
        "A default of *all optional* is a table that may be left out. A key that does not exist is",
        "rejected.",
    ]
    for title, file, root, folder in FILES:
        lines += chapter(title, file, root, folder, all_items, constants)
    text = "\n".join(lines) + "\n"
    if unknown := missing(text):
        sys.exit("not on the page of settings: " + ", ".join(unknown))
    if "--check" not in sys.argv:
        PAGE.write_text(text)
    elif not PAGE.exists() or PAGE.read_text() != text:
        sys.exit("docs/reference/settings.md is not that of the code: run python3 docs/keys.py")


if __name__ == "__main__":
    main()
