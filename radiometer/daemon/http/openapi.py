"""The OpenAPI description, made from the route table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import radiometer
from radiometer.daemon.http.requests import LimitsBody, PatchBody, Route
from radiometer.data import Flag

_NUMBER_OR_NULL: Final = {"type": ["number", "null"]}
_QUANTITY: Final = {
    "type": "object",
    "required": ["value", "u", "unit"],
    "properties": {
        "value": _NUMBER_OR_NULL,
        "u": {**_NUMBER_OR_NULL, "description": "Standard uncertainty (k=1)."},
        "unit": {"type": "string"},
    },
}
_INTEGER: Final = {"type": "integer"}
_STRING: Final = {"type": "string"}
_SCHEMAS: Final[dict[str, Any]] = {
    "Quantity": _QUANTITY,
    "Patch": {
        "type": "object",
        "required": ["x", "y", "width", "height"],
        "properties": dict.fromkeys(("x", "y", "width", "height"), _INTEGER),
    },
    "Reading": {
        "type": "object",
        "required": ["time", "instrument", "patch", "radiance", "luminance", "flags", "exposures_s", "sequence"],
        "properties": {
            "time": {"type": "string", "format": "date-time"},
            "instrument": _STRING,
            "patch": {"$ref": "#/components/schemas/Patch"},
            "radiance": {"$ref": "#/components/schemas/Quantity"},
            "luminance": {"oneOf": [{"$ref": "#/components/schemas/Quantity"}, {"type": "null"}]},
            "coverage_factor": {"type": "number"},
            "band_nm": {"type": "array", "items": {"type": "number"}, "description": "Light that the radiance counts."},
            "U_rel": {**_NUMBER_OR_NULL, "description": "Expanded relative uncertainty."},
            "flags": {"type": "array", "items": {"type": "string", "enum": [str(flag) for flag in Flag]}},
            "exposures_s": {"type": "array", "items": {"type": "number"}},
            "sequence": _INTEGER,
        },
    },
    "PatchBody": PatchBody.model_json_schema(),
    "LimitsBody": LimitsBody.model_json_schema(),
    "Readings": {"type": "array", "items": {"$ref": "#/components/schemas/Reading"}},
    "Status": {"type": "object"},
    "Light": {"type": "object", "properties": {"channel": _STRING, "level": {"type": "number"}}},
    "Response": {
        "type": "object",
        "properties": {
            name: {"type": "array", "items": {"type": "number"}} for name in ("dn", "log_exposure", "u_log_exposure")
        },
    },
    "Events": {
        "type": "array",
        "items": {"type": "object", "properties": dict.fromkeys(("time", "kind", "message"), _STRING)},
    },
    "Event": {"type": "object", "properties": dict.fromkeys(("kind", "message"), _STRING)},
    "Trend": {
        "type": "object",
        "properties": {
            "unit": _STRING,
            **{
                name: {"type": "array", "items": _NUMBER_OR_NULL}
                for name in ("time", "value", "U", "low", "high", "count", "flagged")
            },
            "bound": {"type": "array", "items": {"type": ["string", "null"]}},
        },
    },
    "Health": {
        "type": "object",
        "properties": {"status": {"type": "string", "enum": ["ok", "alarm"]}, "alarms": {"type": "array"}},
    },
    "OpenAPI": {"type": "object"},
    "Error": {
        "type": "object",
        "properties": {"error": {"type": "object", "properties": {"status": _INTEGER, "message": _STRING}}},
    },
}


def description(routes: Sequence[Route]) -> dict[str, Any]:
    """Return the OpenAPI 3.1 description of the routes."""
    paths: dict[str, dict[str, Any]] = {}
    for route in routes:
        paths.setdefault(route.path, {})[route.method.lower()] = _operation(route)
    return {
        "openapi": "3.1.0",
        "info": {"title": "radiometer", "version": radiometer.__version__},
        "paths": paths,
        "components": {"schemas": _SCHEMAS, "securitySchemes": {"token": {"type": "http", "scheme": "bearer"}}},
        "security": [{}, {"token": []}],
    }


def _operation(route: Route) -> dict[str, Any]:
    schema: dict[str, Any] = {"$ref": f"#/components/schemas/{route.schema}"} if route.schema else {"type": "string"}
    failure = {"content": {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}}
    operation: dict[str, Any] = {
        "summary": route.summary,
        "parameters": [
            {"name": name, "in": "query", "description": stated.pop("description"), "schema": stated}
            for name, stated in (route.query.model_json_schema()["properties"] if route.query else {}).items()
        ],
        "responses": {
            "200": {"description": "Done.", "content": {route.reply: {"schema": schema}}},
            "400": {"description": "The request is wrong; nothing was changed.", **failure},
            "503": {"description": "A device or the journal is not there.", **failure},
        },
    }
    if route.body is not None:
        body = route.body.model_json_schema(ref_template="#/components/schemas/{model}")
        body.pop("$defs", None)
        operation["requestBody"] = {"content": {"application/json": {"schema": body}}}
    return operation
