"""With the settings of the image the service is closed until its first key is made (P20)."""

from __future__ import annotations

import asyncio

import httpx

from revisit.service.composition import offline_use_cases
from revisit.service.features.keys.calls import CreateKey
from revisit.service.settings import Settings
from tests.support.processes import ForkedService

OF_THE_IMAGE = {"host": "0.0.0.0", "insecure_bind": 1, "authentication": "on"}


def test_nobody_gets_in_before_the_first_key_and_its_owner_does_afterwards(tmp_path, monkeypatch):
    running = ForkedService(tmp_path / "home", workers=0, **OF_THE_IMAGE)
    try:
        assert "keys create" in running.wait_for("closed_to_everyone")["hint"]
        with httpx.Client(base_url=running.url, trust_env=False) as http:
            assert http.get("/livez").status_code == 200
            assert http.get("/v1/maps").status_code == 401
            assert http.post("/v1/maps", json={"map_id": "town"}).status_code == 401
            monkeypatch.setenv("REVISIT_HOME", str(tmp_path / "home"))
            with offline_use_cases(Settings()) as use_cases:
                key = asyncio.run(use_cases.keys.create(CreateKey("acme", ["query"])))
            shown = {"authorization": f"Bearer {key.text}"}
            assert http.get("/v1/maps", headers=shown).status_code == 200
            assert http.get("/v1/maps").status_code == 401
    finally:
        running.close()
