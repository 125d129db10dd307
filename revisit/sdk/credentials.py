"""A client's credentials, and its check of the service's certificate."""

from __future__ import annotations

import os
import ssl
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Self


@dataclass(frozen=True)
class Credentials:
    """An API key (or token); for TLS the authorities to trust instead of the system's, and a client certificate."""

    api_key: str | None = field(default=None, repr=False)
    ca: Path | None = None
    certificate: Path | None = None
    key: Path | None = None

    @classmethod
    def given(cls, api_key: str | None = None, ca: str | Path | None = None) -> Self:
        """Arguments, else $REVISIT_API_KEY and $REVISIT_CA; $REVISIT_CERTIFICATE with $REVISIT_CERTIFICATE_KEY."""
        path = {name: os.environ.get(f"REVISIT_{name}") for name in ("CA", "CERTIFICATE", "CERTIFICATE_KEY")}
        files = {name: Path(value) if value else None for name, value in path.items()}
        return cls(
            api_key=api_key or os.environ.get("REVISIT_API_KEY") or None,
            ca=Path(ca) if ca else files["CA"],
            certificate=files["CERTIFICATE"],
            key=files["CERTIFICATE_KEY"],
        )

    def authorization(self) -> dict[str, str]:
        """The header, or metadata, that shows the key; empty without one."""
        return {"authorization": f"Bearer {self.api_key}"} if self.api_key else {}

    def ssl_context(self) -> ssl.SSLContext:
        """For HTTPS. Raises OSError where a file cannot be used."""
        try:
            context = ssl.create_default_context(cafile=self.ca)
        except ssl.SSLError as error:
            raise OSError(f"REVISIT_CA (or ca): {self.ca} holds no certificate in PEM form") from error
        except OSError as error:
            raise OSError(f"REVISIT_CA (or ca): {self.ca} cannot be read: {error.strerror}") from error
        if self.certificate is not None:
            context.load_cert_chain(self.certificate, self.key)
        return context
