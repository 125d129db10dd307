"""The page /docs: every call of the OpenAPI document, from files of the service's own, under its security policy."""

from __future__ import annotations

import re
from html.parser import HTMLParser

import httpx
import pytest


class Page(HTMLParser):
    """What a page links to and loads, its ids, and elements that are not closed."""

    VOID = ("meta", "link", "br")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.links, self.loaded, self.ids, self.open, self.styles = [], [], [], [], 0
        self.feed(html)

    def handle_starttag(self, tag, attributes):
        told = dict(attributes)
        self.ids += [told["id"]] if "id" in told else []
        self.links += [told["href"]] if tag == "a" else []
        self.loaded += [told.get("src") or told.get("href")] if tag in ("link", "script", "img", "iframe") else []
        self.styles += "style" in told or tag in ("style", "script")
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def document(service):
    return httpx.get(f"{service.http}/openapi.json").json()


@pytest.fixture(scope="module")
def answer(service):
    return httpx.get(f"{service.http}/docs")


def test_the_page_is_html_with_the_policy_of_the_others(service, answer):
    assert answer.status_code == 200 and answer.headers["content-type"].startswith("text/html")
    assert "default-src 'none'" in answer.headers["content-security-policy"]
    assert httpx.get(f"{service.http}/docs.css").headers["content-type"].startswith("text/css")


def test_it_has_every_call_and_every_schema(document, answer):
    page = Page(answer.text)
    calls = [call["operationId"] for methods in document["paths"].values() for call in methods.values()]
    schemas = [f"schema-{name}" for name in document["components"]["schemas"]]
    assert len(calls) > 20 and set(calls) | set(schemas) <= set(page.ids)
    assert page.open == [] and len(page.ids) == len(set(page.ids))


def test_it_loads_nothing_but_its_own_style_and_every_link_leads_somewhere(service, answer):
    page = Page(answer.text)
    assert page.loaded == ["/docs.css"] and page.styles == 0
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    for link in {link for link in page.links if not link.startswith("#")}:
        assert httpx.get(f"{service.http}{link}").status_code == 200


def test_each_call_has_an_example_for_curl_with_what_it_needs(document, answer):
    examples = re.findall(r"<pre>(.*?)</pre>", answer.text, re.DOTALL)
    assert len(examples) == sum(len(methods) for methods in document["paths"].values())
    posted = next(example for example in examples if "submaps?submap_id=" in example)
    assert "application/vnd.npy" in posted and "stamp_ns=" in posted and "REVISIT_API_KEY" in posted
