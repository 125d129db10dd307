// Swagger UI over the service's own description. The API key of the page in this tab goes with each call.
"use strict";

const KEY = "revisit-api-key";

/** A call with the key of the tab, unless another was given by "Authorize". */
function authorized(request) {
  const key = sessionStorage.getItem(KEY);
  if (key && !request.headers.authorization && !request.headers.Authorization) request.headers.authorization = `Bearer ${key}`;
  return request;
}

globalThis.SwaggerUIBundle({
  url: "/openapi.json",
  dom_id: "#calls",
  deepLinking: true,
  docExpansion: "none",
  defaultModelsExpandDepth: -1,
  filter: true,
  tryItOutEnabled: true,
  validatorUrl: null,
  requestInterceptor: authorized,
});
