"""Traces by OpenTelemetry. Only imported where the settings name an endpoint: it brings many modules."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager

from opentelemetry import trace
from opentelemetry.exporter.otlp.proto.grpc.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import SpanProcessor, TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from revisit.service import VERSION
from revisit.service.ports.tracing import Role, Span

CLOSE_WITHIN_MS = 2_000
_KINDS = {Role.REQUEST: trace.SpanKind.SERVER, Role.JOB: trace.SpanKind.CONSUMER}


class OpenTelemetryTracer:
    """`Tracer` with a processor for its spans."""

    def __init__(self, processor: SpanProcessor, process: str) -> None:
        """`process` says which of the service's processes this is: gateway or worker."""
        about = {"service.name": f"revisit-{process}", "service.namespace": "revisit", "service.version": VERSION}
        self._provider = TracerProvider(resource=Resource.create(about), shutdown_on_exit=False)
        self._provider.add_span_processor(processor)
        self._tracer = self._provider.get_tracer("revisit", VERSION)

    @contextmanager
    def span(
        self, role: Role, name: str, traceparent: str | None, attributes: Mapping[str, str | int]
    ) -> Iterator[Span]:
        """See `Tracer`."""
        parent = TraceContextTextMapPropagator().extract({"traceparent": traceparent} if traceparent else {})
        span = _OpenTelemetrySpan(self._tracer.start_span(name, parent, kind=_KINDS[role], attributes=dict(attributes)))
        try:
            yield span
        except Exception as error:
            span.fail(type(error).__name__)
            raise
        finally:
            span.end()

    def close(self) -> None:
        """See `Tracer`; gives up after 2 s."""
        self._provider.force_flush(CLOSE_WITHIN_MS)


class _OpenTelemetrySpan(Span):
    """A span that is recorded."""

    def __init__(self, span: trace.Span) -> None:
        context = span.get_span_context()
        super().__init__(f"00-{context.trace_id:032x}-{context.span_id:016x}-{int(context.trace_flags):02x}")
        self._span = span

    def rename(self, name: str) -> None:
        """See `Span`."""
        self._span.update_name(name)

    def note(self, **attributes: str | int | float | bool) -> None:
        """See `Span`."""
        self._span.set_attributes(attributes)

    def fail(self, reason: str) -> None:
        """See `Span`."""
        self._span.set_status(trace.StatusCode.ERROR, reason)

    def end(self) -> None:
        """The work has ended."""
        self._span.end()


def otlp_tracer(endpoint: str, process: str) -> OpenTelemetryTracer:
    """Sends spans to an OTLP endpoint over gRPC (http://host:port, or https), in batches, beside the work.

    Spans are dropped where the endpoint does not take them; the work goes on.
    """
    exporter = OTLPSpanExporter(endpoint=endpoint, insecure=endpoint.startswith("http://"))
    return OpenTelemetryTracer(BatchSpanProcessor(exporter), process)
