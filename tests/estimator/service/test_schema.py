"""The API keeps to its own schema: valid and invalid requests made from it give no fault and no answer that it does not document."""

from __future__ import annotations

import os
from typing import Any

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from tests.estimator.service.conftest import import_csv, upload_rig

CHECKS = [  # not those which want every body of the right type to be accepted: a rig is more than a text
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_schema_conformance,
]
EXAMPLES = int(os.environ.get("COILCAL_SCHEMA_EXAMPLES", "25"))  # of each route


def test_the_schema_is_openapi_3_1_and_every_operation_documents_its_refusals(idle):
    schema = idle().get("/v1/openapi.json").json()
    assert schema["openapi"].startswith("3.1")
    for path, item in schema["paths"].items():
        for method, operation in item.items():
            assert operation["summary"], (method, path)
            assert {"401", "403", "422", "429", "500"} <= operation["responses"].keys(), (method, path)
            kinds = operation["responses"]["422"]["content"]
            assert list(kinds) == ["application/problem+json"], (method, path)


@pytest.mark.slow
def test_no_request_made_from_the_schema_gives_a_fault(served, rig_text, readings_csv):
    service = served()
    import_csv(service.client, upload_rig(service.client, rig_text), readings_csv)
    schema = schemathesis.openapi.from_url(f"{service.url}/v1/openapi.json")
    n_asked, faults = 0, []
    for result in schema.get_all_operations():
        operation = result.ok()
        if operation.path.endswith(("/import-zip", "/import-csv", "/readings", "/events")):
            continue  # schemathesis makes no such bodies, and reads no streams
        try:
            n_asked += ask(operation)
        except FailureGroup as group:
            faults.append(str(group))
            faults += [str(fault) for fault in group.exceptions]
    assert faults == []
    assert n_asked > EXAMPLES
    assert service.client.get("/healthz").status_code == 200


def ask(operation: Any) -> int:
    """Make requests to one operation and check the answers; how many there were."""
    n = 0

    @given(case=operation.as_strategy())
    @settings(max_examples=EXAMPLES, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
    def check(case: Any) -> None:
        nonlocal n
        n += 1
        case.call_and_validate(checks=CHECKS)

    check()
    return n
