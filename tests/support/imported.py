"""What a gateway imports and loads when it starts, for processes that begin as a copy of one that has done so."""

from __future__ import annotations

import uvloop  # noqa: F401

import revisit.service.gateway
import revisit.service.grpc.server
import revisit.service.rest.app
import revisit.service.rest.listening  # noqa: F401
import tests.faults.drive  # noqa: F401
from revisit.core.kernels import adapted_cosines
from revisit.formats import quantised_columns

quantised_columns.warm_up()
adapted_cosines.warm_up()
