"""The reference pages that are written from the code: errors, settings, the command line, REST and gRPC."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from revisit.core.point_columns import COLUMNS, PointColumn

ROOT = Path(__file__).resolve().parent.parent

INSIDE = {"RevisitError", "Unavailable", "StaleLease", "OutOfTurn"}
"""Errors that clients see under other names, or not at all."""

OF_THE_MACHINE = {"workers": "one less than the cores, at least 1"}
"""Defaults of settings that are not the same everywhere."""

ADVICE = {
    "MALFORMED_BODY": "Check that the bytes are what Content-Type says, and complete. A stream begins with Open, then "
    "sends scans only.",
    "UNUSABLE_CLOUD": "Leave this cloud out and go on. Where it happens often: filter NaN and infinite points, send "
    "points in metres in the sensor frame, and look at the sensor.",
    "BAD_FIELD": "Read `field` and `detail`: they name the value and its bounds. A pose takes a unit quaternion "
    "(x, y, z, w) or a rotation matrix without scale.",
    "UNSUPPORTED_ENCODING": "Use one of the content types and encodings of the API description.",
    "TOO_LARGE": "Send fewer points, compress the body, or use a binary format in place of ASCII.",
    "NOT_FOUND": "Create the resource first; check the id.",
    "METHOD_NOT_ALLOWED": "Check the method and the path.",
    "ALREADY_EXISTS": "Use another id: this one stands for other content. The same content again is no error.",
    "SESSION_FINISHED": "Begin a new session.",
    "DESCRIPTOR_MODEL_MISMATCH": "Search with descriptors of the map's model. After an upgrade: `revisit reembed`.",
    "NOT_READY": "Wait for the submap's operation.",
    "SEQ_GAP": "Send the scan of `expected_seq` next; the SDK does so.",
    "STREAM_FENCED": "Let only one client stream a session; the newest one keeps it.",
    "QUOTA": "Delete sessions or maps that you do not need, or ask for more room; then send the same again.",
    "RATE": "Wait for `Retry-After` and send the same again, fewer at a time; of a stream, read its answers.",
    "WORKERS_BUSY": "Wait for `Retry-After` and send the same again; add workers if this stays.",
    "DRAINING": "Send the same again to the service that comes back.",
    "STORAGE_UNCERTAIN": "Send the same again with the same ids: that settles whether it was stored.",
    "STORAGE_FULL": "Free disk space; then send the same again.",
    "DEADLINE_EXCEEDED": "Send the same again, or wait longer (`timeout_s`); for bodies, send faster.",
    "NO_ANSWER": "See in `revisit doctor` or `/readyz` if a worker is ready and how many jobs wait; then ask again.",
    "SEQ_NOT_REACHED": "Wait longer (`min_seq_timeout_s`), or ask without `min_seq` for what is known by now.",
    "UNAUTHENTICATED": "Send a valid API key, or ask whoever runs the service for one: `revisit keys create`.",
    "PERMISSION_DENIED": "Use a key with the scope that `detail` names; address the service by a name it knows "
    "(REVISIT_ALLOWED_HOSTS), and from its own pages only.",
    "EXTRA_MISSING": "Install the extra that `detail` names where the workers run, start the service again, and queue "
    "the operation again: `revisit operations --retry`.",
    "DATA_LOSS": "Restore the volume: a stored file is damaged. The log names it. A form no longer read is no damage: "
    "`revisit reembed MAP` makes it anew.",
    "INTERNAL": "A defect: report it with the request id and the log entry it leads to.",
}


def errors() -> str:
    """docs/reference/errors.md."""
    from revisit.core.errors import FORMER_CODES, ErrorCode
    from revisit.service.status import STATUS

    meanings = dict(_meanings())
    parts = [
        "# Errors",
        (
            "Every refusal carries one of these reasons: over HTTP as `reason` of an `application/problem+json` body "
            "(RFC 9457), over gRPC as `reason` of a `google.rpc.ErrorInfo`, in the SDK as `error.reason`. After a 4xx "
            "nothing was stored. Where an error is retryable, send the same request with the same ids again; "
            "`Retry-After` (`RetryInfo`) says when. *No loop* and *rejected* are answers, not errors: see "
            "[how to read an answer](../how-to/read-an-answer.md)."
        ),
    ]
    for code in ErrorCode:
        status = STATUS[code]
        again = "retryable" if status.retryable else "not retryable"
        parts += [
            f"## {code.value}",
            f"HTTP {status.http}, gRPC {status.grpc}, {again}.",
            " ".join(meanings.get(code.value, [])),
            ADVICE[code.value],
        ]
    rows = [f"| `{former}` | `{today}` |" for former, today in FORMER_CODES.items()]
    parts += ["## Former codes", "\n".join(["| former code | today |", "|---|---|", *rows])]
    return _page(parts)


def settings() -> str:
    """docs/reference/settings.md."""
    from revisit.service.settings import GONE, GROUPS, ForTests, Settings

    parts = [
        "# Settings",
        (
            "The service reads these environment variables and no file. `revisit serve` has options for the commonest. "
            "A value that cannot be used ends the start with status 78 and the variable's name; so does a misspelt "
            "variable, with the nearest name, and one that is gone, with what stands in its place."
        ),
    ]
    for title, names in GROUPS.items():
        parts += [f"## {title}", *(part for name in names for part in _setting(name, Settings.model_fields[name]))]
    parts += [
        "## For tests",
        "No promise of stability.",
        "### REVISIT_FOR_TESTS",
        _sentence(str(Settings.model_fields["for_tests"].description)),
        f"Default: `{ForTests().model_dump_json()}`.",
    ]
    rows = [f"| `REVISIT_{name.upper()}` | {_sentence(reason)} |" for name, reason in GONE.items()]
    parts += ["## Gone", "\n".join(["| former variable | instead |", "|---|---|", *rows])]
    return _page(parts)


def _setting(name: str, field: Any) -> tuple[str, str]:
    """The heading and the text of a setting."""
    if name in OF_THE_MACHINE:
        default = OF_THE_MACHINE[name]
    elif field.default_factory is not None:
        default = f"`{cast(Any, field.default_factory)()}`, of the [parameters](parameters.md)"
    elif field.default in (None, ""):
        default = "not set"
    else:
        default = f"`{field.default}`"
    bounds = ", ".join(filter(None, map(_bound, field.metadata)))
    text = f"{_sentence(str(field.description))} Default: {default}." + (f" Bounds: {bounds}." if bounds else "")
    return f"### REVISIT_{name.upper()}", text


def command_line() -> str:
    """docs/reference/cli.md."""
    import typer

    from revisit.cli.app import app
    from revisit.cli.former_names import FORMER
    from revisit.sdk.addresses import FORMER as FORMER_VARIABLES

    group = cast(Any, typer.main.get_command(app))
    parts = [
        "# The `revisit` command",
        (
            "Exit status 0: done. 1: refused or not found, with one line on stderr. 2: the command line is wrong. "
            "78: settings cannot be used. Progress goes to stderr and answers to stdout; `--json` makes the answer one "
            "JSON document."
        ),
        (
            "One address for all commands: `--http http://HOST:PORT`, or HOST for port 8080, or the variable "
            "REVISIT_HTTP; by default this machine. Commands that stream ask the service there for its gRPC side; "
            "beside port 8080 of one that does not answer they take port 8090. `--grpc HOST:PORT` or REVISIT_GRPC "
            "names another. Options go before variables."
        ),
    ]
    for name, command in commands_of(group, "revisit"):
        rows = [_option_row(parameter) for parameter in command.params if parameter.name != "help"]
        parts += [f"## {name}", str(command.help)]
        parts += ["\n".join(["| argument or option | default | meaning |", "|---|---|---|", *rows])] if rows else []
    gone = [f"| `revisit {name}` | `{instead}` |" for name, instead in FORMER.items()]
    gone += [f"| `{name}` | `{instead}` |" for name, instead in FORMER_VARIABLES.items()]
    parts += ["## Former names", "\n".join(["| former name | instead |", "|---|---|", *gone])]
    return _page(parts)


def commands_of(group: Any, prefix: str) -> Iterator[tuple[str, Any]]:
    """Every command under a group with its whole name, groups before their commands."""
    for name, command in group.commands.items():
        yield f"{prefix} {name}", command
        if hasattr(command, "commands"):
            yield from commands_of(command, f"{prefix} {name}")


def interfaces() -> str:
    """docs/reference/rest-and-grpc.md."""
    parts = [
        "# REST and gRPC",
        (
            "Both call the same use cases and give the same answers; a test drives both through one client. An answer "
            "over REST is the JSON that protobuf defines for its message, with the names of the proto files: 64-bit "
            "integers (`seq`, `number`, `..._ns`) are strings, and what is absent is left out. "
            "[openapi.json](openapi.json) and [proto/revisit/v1](../../proto/revisit/v1) hold every field."
        ),
        "## REST",
        *_rest_parts(),
        "## gRPC",
        "Also served: `grpc.health.v1.Health` for every service, and reflection.",
        *_grpc_parts(),
    ]
    return _page(parts)


CALLS_OF_CLIENT = (
    "stream", "spooled_stream", "relocalise", "holds_scan", "watch", "watch_corrections", "explain", "delete", "status",
    "call",
)  # fmt: skip
"""Methods of `Client` that are in no group."""


def sdk() -> str:
    """docs/reference/sdk.md."""
    from revisit.sdk.client import Client

    parts = [
        "# The Python SDK",
        (
            "`from revisit import Client`, or `AsyncClient` for an event loop: the same groups of calls, each awaited "
            '(`await client.maps.get("yard")`). Both speak REST (`Client("https://host:8080")`) and gRPC '
            '(`Client.grpc("grpcs://host:8090")`). Every call raises `revisit.sdk.errors.ApiError`; transforms are '
            "(4, 4) matrices named `T_target_source`, lengths metres. A call that has a short name can be written "
            "by it."
        ),
        (
            "`with within(2.0): ...` (`from revisit import within`) bounds the time of the calls in the block, with "
            "all that is repeated: one that takes longer raises DeadlineExceeded (TIME_LIMIT). "
            '`picture(client, "town")` is a drawing of a map that a notebook shows; `.save(file)` writes it as SVG. '
            "`to_dataframe(resources)` is a table of pandas."
        ),
        (
            "Points are (n, 3) in metres, (n, 4) with intensity, or `PointCloud(points, columns)`, columns by name: "
            f"{', '.join(map(_column, COLUMNS.values()))}. A column out of range raises BadField. Downloads as pcd and "
            "ply hold them, with times in seconds since 1970 on the clock of `stamp_ns`; npy holds intensity alone."
        ),
    ]
    # Nothing is called here: the transport is not used.
    client = Client(transport=cast(Any, None))
    short = {value: name for name, value in vars(client).items() if inspect.ismethod(value)}
    for group, calls in client.groups.items():
        parts.append(f"## client.{group}")
        for name, function in inspect.getmembers(type(calls), inspect.isfunction):
            if not name.startswith("_"):
                parts.append(f"### client.{group}.{name}")
                parts.append(_arguments(function))
                parts.append(_paragraphs(function) + _also(short.get(getattr(calls, name))))
    parts.append("## client")
    for name in CALLS_OF_CLIENT:
        parts += [f"### client.{name}", _arguments(getattr(Client, name)), _paragraphs(getattr(Client, name))]
    return _page(parts)


def _column(column: PointColumn) -> str:
    """A column in words: its name, range, unit and shape."""
    channels = f", (n, {column.channels})" if column.channels > 1 else ""
    return f"`{column.name}` ({column.low:,} to {column.high:,}, {column.unit}{channels})"


def _arguments(function: Any) -> str:
    """The arguments of a method as they are written, without its types."""
    found = [one for name, one in inspect.signature(function).parameters.items() if name != "self"]
    plain = [one.replace(annotation=inspect.Parameter.empty) for one in found]
    return f"`{function.__name__}{inspect.Signature(plain)}`"


def _paragraphs(function: Any) -> str:
    paragraphs = inspect.cleandoc(function.__doc__ or "").split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _also(name: str | None) -> str:
    return "" if name is None else f" Short: `client.{name}`."


def _rest_parts() -> Iterator[str]:
    from revisit.service.rest.app import create_app
    from revisit.service.use_cases import UseCases

    document = create_app(cast(UseCases, None)).openapi()
    for path, methods in sorted(document["paths"].items()):
        for method, call in methods.items():
            yield f"### {method.upper()} {path}"
            yield str(call.get("description", call["summary"]))
            named = [
                f"`{p['name']}` ({p['in']}{', required' if p.get('required') else ''})"
                for p in call.get("parameters", [])
                if p["in"] != "path"
            ]
            if named:
                yield f"Parameters: {', '.join(named)}."


def _grpc_parts() -> Iterator[str]:
    for file in sorted((ROOT / "proto/revisit/v1").glob("*.proto")):
        comment: list[str] = []
        service = ""
        for line in map(str.strip, file.read_text(encoding="utf-8").splitlines()):
            if line.startswith("//"):
                comment.append(line[2:].strip())
                continue
            if found := re.match(r"service (\w+)", line):
                service = found[1]
            elif found := re.match(r"rpc (\w+)\((stream )?.*returns \((stream )?", line):
                streams = {(True, True): " (both sides stream)", (False, True): " (the answers are a stream)"}
                yield f"### {service}.{found[1]}"
                yield " ".join(comment) + streams.get((bool(found[2]), bool(found[3])), "")
            comment = []


def _meanings() -> Iterator[tuple[str, list[str]]]:
    """Each code with what the exceptions that carry it say by default."""
    from revisit.core import errors as of_core
    from revisit.service.domain import errors as of_service
    from revisit.service.grpc import scan_streams
    from revisit.service.rest import errors as of_rest

    found: dict[str, list[str]] = {}
    modules = (of_core, of_service, of_rest, scan_streams)
    for module in modules:
        for kind in vars(module).values():
            if inspect.isclass(kind) and issubclass(kind, of_core.RevisitError) and kind.__doc__:
                texts = found.setdefault(kind.code.value, [])
                if kind.__module__ == module.__name__ and (text := " ".join(inspect.cleandoc(kind.__doc__).split())):
                    texts += [text] if kind.__name__ not in INSIDE else []
    yield from found.items()


def _option_row(parameter: Any) -> str:
    names = "`" + "`, `".join([*parameter.opts, *parameter.secondary_opts]) + "`"
    if parameter.param_type_name == "argument":
        names = f"`{parameter.name.upper()}`"
    default = "" if parameter.default in (None, "", False) else f"`{parameter.default}`"
    if parameter.required:
        default = "required"
    text = parameter.help or ""
    return f"| {names} | {default} | {text}{f' Or {parameter.envvar}.' if parameter.envvar else ''} |"


def _bound(bound: Any) -> str:
    words = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
    return " and ".join(f"{words[name]} {value}" for name in words if (value := getattr(bound, name, None)) is not None)


def _sentence(text: str) -> str:
    return (text if text.startswith("gRPC") else text[:1].upper() + text[1:]).rstrip(".") + "."


def _page(parts: list[str]) -> str:
    note = "Written from the code by `make docs`."
    return "\n\n".join([parts[0], note, *(part for part in parts[1:] if part)]) + "\n"
