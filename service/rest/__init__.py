"""HTTP: parse, call a use case, render. `service.rest.app.create_app` is the way in."""
