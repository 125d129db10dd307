"""The page `/docs` of the service, written from the OpenAPI document: plain HTML, no scripts, no outside requests."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from typing import Any
from urllib.parse import quote

Json = dict[str, Any]

ORDER = ("maps", "sessions", "scans", "submaps", "searches", "loop closures", "operations", "robots", "system")
BASE = "http://127.0.0.1:8080"
_MATERIAL = "application/vnd.npy"


def page(document: Json) -> str:
    """The HTML page of an OpenAPI document."""
    calls = [(path, method, call) for path, methods in document["paths"].items() for method, call in methods.items()]
    groups = [tag for tag in ORDER if any(tag == _group(call) for _, _, call in calls)]
    groups += sorted({_group(call) for _, _, call in calls} - set(groups))
    body = [
        _HEAD.format(title=escape(document["info"]["title"])),
        "<nav>",
        *(f'<a href="#{_anchor(tag)}">{escape(tag)}</a>' for tag in groups),
        '<a href="#schemas">answers</a></nav><main>',
        _INTRODUCTION,
    ]
    for tag in groups:
        body.append(f'<h2 id="{_anchor(tag)}">{escape(tag)}</h2>')
        body += [_call(path, method, call, document) for path, method, call in calls if _group(call) == tag]
    body.append('<h2 id="schemas">answers</h2>')
    body += [_schema(name, schema) for name, schema in document["components"]["schemas"].items()]
    return "\n".join([*body, "</main></body></html>", ""])


_HEAD = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}: REST</title><link rel="stylesheet" href="/docs.css"></head><body>
<header><a href="/">{title}</a> <span>REST</span> <a href="/try">try it</a>
<a href="/openapi.json">openapi.json</a></header>"""

_INTRODUCTION = """<p>JSON in and out; clouds are bodies of their own, by content type. Transforms are
<code>T_target_source</code>: metres and a unit quaternion in the order <b>x, y, z, w</b>; times are nanoseconds. 64-bit
integers are strings, absent fields are left out. With keys: <code>Authorization: Bearer KEY</code>, of one of the
scopes named.</p>
<p>Errors are <code>application/problem+json</code> with a <code>reason</code>; one that is <code>retryable</code> is
repeated as it was. <i>No loop</i> and <i>rejected</i> are answers, not errors.</p>"""


def _call(path: str, method: str, call: Json, document: Json) -> str:
    badge = f'<b class="{method}">{method.upper()}</b> <code>{escape(path)}</code>'
    parts = [
        f'<details id="{escape(call["operationId"])}">',
        f"<summary>{badge} <span>{escape(call['summary'])}</span></summary>",
        f"<p>{_text(call.get('description', ''))}</p>",
        f'<p class=scopes>{_scopes(call)} <a href="{escape(_try_it(call))}">try it</a></p>',
        *_parameters(call.get("parameters", [])),
        *_body(call.get("requestBody"), document),
        f"<h4>Answers</h4><ul>{''.join(_answers(call['responses'], document))}</ul>",
        f"<pre>{escape(_curl(path, method, call))}</pre></details>",
    ]
    return "".join(parts)


def _try_it(call: Json) -> str:
    """Where the call is opened on the page `/try`."""
    return f"/try#/{quote(_group(call))}/{call['operationId']}"


def _scopes(call: Json) -> str:
    scopes = [scope for item in call.get("security", []) for scopes in item.values() for scope in scopes]
    return f"Scope: {escape(' or '.join(scopes))}" if scopes else "No key needed"


def _parameters(parameters: list[Json]) -> Iterator[str]:
    if parameters:
        rows = (
            f"<tr><td><code>{escape(item['name'])}</code></td><td>{item['in']}"
            f"{', required' if item.get('required') else ''}</td><td>{escape(_kind(item['schema']))}</td>"
            f"<td>{_text(item.get('description', ''))}</td></tr>"
            for item in parameters
        )
        yield f"<h4>Parameters</h4><table>{''.join(rows)}</table>"


def _body(body: Json | None, document: Json) -> Iterator[str]:
    if body is None:
        return
    yield f"<h4>Body</h4><p>{_text(body.get('description', ''))}</p>"
    for kind, content in body["content"].items():
        schema = content.get("schema", {})
        fields = _fields(_resolved(schema, document)) if kind == "application/json" else ""
        yield f"<p><code>{escape(kind)}</code> {escape(_kind(schema))}</p>{fields}"


def _answers(responses: Json, document: Json) -> Iterator[str]:
    for status, response in responses.items():
        told = _resolved(response, document)
        schemas = [content.get("schema", {}) for content in told.get("content", {}).values()]
        yield f"<li><code>{status}</code> {_text(told.get('description', ''))} {' '.join(map(_linked, schemas))}</li>"


def _schema(name: str, schema: Json) -> str:
    told = f"<p>{_text(schema.get('description', ''))}</p>"
    values = f"<p>{escape(', '.join(schema['enum']))}</p>" if "enum" in schema else ""
    return f'<section id="schema-{escape(name)}"><h3>{escape(name)}</h3>{told}{values}{_fields(schema)}</section>'


def _fields(schema: Json) -> str:
    required = schema.get("required", [])
    rows = (
        f"<tr><td><code>{escape(name)}</code></td><td>{'' if name in required else 'optional'}</td>"
        f"<td>{_linked(field) or escape(_kind(field))}</td><td>{_text(field.get('description', ''))}</td></tr>"
        for name, field in schema.get("properties", {}).items()
    )
    return f"<table>{''.join(rows)}</table>" if schema.get("properties") else ""


def _curl(path: str, method: str, call: Json) -> str:
    filled = path.replace("{", "").replace("}", "").replace("_id", "")
    needed = [item["name"] for item in call.get("parameters", []) if item["in"] == "query" and item.get("required")]
    query = "?" + "&".join(f"{name}=..." for name in needed) if needed else ""
    lines = [f"curl -fsS {'' if method == 'get' else f'-X {method.upper()} '}'{BASE}{filled}{query}'"]
    if _scopes(call).startswith("Scope"):
        lines.append('-H "authorization: Bearer $REVISIT_API_KEY"')
    content = call.get("requestBody", {}).get("content", {})
    if _MATERIAL in content:
        lines.append(f"-H 'content-type: {_MATERIAL}' --data-binary @cloud.npy")
    elif "application/json" in content:
        lines.append("-H 'content-type: application/json' -d '{...}'")
    return " \\\n  ".join(lines)


def _kind(schema: Json) -> str:
    """The type of a schema in words."""
    if "$ref" in schema:
        return str(schema["$ref"]).rpartition("/")[2]
    if "anyOf" in schema:
        return " or ".join(_kind(item) for item in schema["anyOf"] if item.get("type") != "null")
    if schema.get("type") == "array":
        return f"list of {_kind(schema['items'])}"
    bounds = [f"{word} {schema[key]}" for word, key in (("from", "minimum"), ("to", "maximum")) if key in schema]
    values = f"one of {', '.join(map(str, schema['enum']))}" if "enum" in schema else ""
    return " ".join([str(schema.get("format", schema.get("type", ""))), *bounds, values]).strip()


def _linked(schema: Json) -> str:
    """A link to the schema that is meant, "" where it has no name."""
    inner = schema.get("items", schema)
    if not str(inner.get("$ref", "")).startswith("#/components/"):
        return ""
    name = escape(_kind(inner))
    return f'{"list of " if "items" in schema else ""}<a href="#schema-{name}">{name}</a>'


def _resolved(item: Json, document: Json) -> Json:
    for part in str(item.get("$ref", "")).split("/")[1:]:
        document = document[part]
    return document if "$ref" in item else item


def _text(text: str) -> str:
    """Text with what stands in backticks as code."""
    pieces = escape(" ".join(text.split()), quote=False).split("`")
    return "".join(f"<code>{piece}</code>" if index % 2 else piece for index, piece in enumerate(pieces))


def _group(call: Json) -> str:
    return str(call.get("tags", ["system"])[-1])


def _anchor(tag: str) -> str:
    return escape(tag.replace(" ", "-"))
