"""Every refusal of the service as problem+json (RFC 9457) with thing, rule, value and place; no traceback leaves the service."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.routing import iter_route_contexts
from pydantic import BaseModel, ConfigDict
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import JSONResponse, Response
from starlette.routing import compile_path

from estimator.errors import CoilcalError, CorruptStore

MEDIA_TYPE = "application/problem+json"
MOST_SHOWN = 200  # characters of a value
MOST_SAID = 800  # and of a sentence
SENTENCE = re.compile(
    r"(?P<thing>.+?) (?P<rule>(?:must|is not|is missing|takes) .*?)"
    r"(?:; (?:received )?(?P<value>.*?))?(?:; the closest is .*?)?"
    r"(?: \((?P<place>[^()]*)\))?\.?"
)
# Control characters, and halves of characters, which no answer can hold.
CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff]")
log = logging.getLogger("coilcal.service")


class ProblemBody(BaseModel):
    """A refusal: one sentence, and its parts as far as they can be told apart."""

    model_config = ConfigDict(title="Problem")

    type: str = "about:blank"
    title: str
    status: int
    detail: str
    thing: str | None
    rule: str | None
    value: str | None
    place: str | None
    request_id: str


class Problem(CoilcalError):
    """A refusal with its status.

    Args:
        status: HTTP status.
        thing, rule, value, place: What the sentence consists of; `value` and `place` may be left out.
        headers: Headers of the answer.
    """

    def __init__(
        self,
        status: int,
        thing: str,
        rule: str,
        value: object = None,
        place: str | None = None,
        headers: Mapping[str, str] | None = None,
    ) -> None:
        self.status, self.headers = status, dict(headers or {})
        self.parts: dict[str, str | None] = {
            "thing": thing,
            "rule": rule,
            "value": None if value is None else shown(value),
            "place": place,
        }
        received = "" if value is None else f"; received {shown(value)}"
        super().__init__(f"{thing} {rule}{received}" + (f" ({place})" if place else ""))


def not_found(thing: str, value: str) -> Problem:
    """The refusal of an id that the service has not given, or not to this user."""
    return Problem(404, thing, "must be one that the service holds", value)


def check_limits(
    limits: Mapping[str, tuple[int | None, float]], status: int, rule: str, retry_after_s: int | None = None
) -> None:
    """Refuse one more of something of which there is enough.

    Args:
        limits: By what it is, how many there are and may be.
        status: Of the refusal.
        rule: Of the refusal; {} stands for how many there may be.
        retry_after_s: When to ask again; None says nothing of it.
    Raises:
        Problem: There is enough of one.
    """
    headers = None if retry_after_s is None else {"Retry-After": str(retry_after_s)}
    for thing, (n, most) in limits.items():
        if (n or 0) >= most:
            raise Problem(status, thing, rule.format(most), headers=headers)


def shown(value: object, most: int = MOST_SHOWN) -> str:
    """A value as a refusal shows it: short, and without characters that steer a terminal."""
    text = CONTROL.sub(lambda control: repr(control[0])[1:-1], str(value))
    return text if len(text) <= most else f"{text[:most]}..."


def parts_of(sentence: str) -> dict[str, str | None]:
    """Thing, rule, value and place of a sentence as coilcal writes them; None for what it does not say.

    Examples:
        >>> parts_of("coil1.radius_m must be > 0; received -0.05 (rig, line 3)")
        {'thing': 'coil1.radius_m', 'rule': 'must be > 0', 'value': '-0.05', 'place': 'rig, line 3'}
        >>> parts_of("ducks float")["thing"] is None
        True
    """
    parts = SENTENCE.fullmatch(sentence)
    return parts.groupdict() if parts else dict.fromkeys(("thing", "rule", "value", "place"))


def answer(
    status: int,
    sentence: str,
    parts: Mapping[str, str | None],
    request_id: str,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """The answer that tells of a refusal."""
    title = HTTPStatus(status).phrase
    words = {"detail": sentence, **parts}  # which may hold what a client sent
    told: dict[str, Any] = {
        name: None if text is None else shown(text, MOST_SAID) for name, text in words.items()
    }
    told |= {"title": title, "status": status, "request_id": request_id}
    body = ProblemBody.model_validate(told)
    return JSONResponse(body.model_dump(), status, headers=dict(headers or {}), media_type=MEDIA_TYPE)


def answer_to(problem: Problem, request_id: str) -> Response:
    """The answer to a refusal outside of a route."""
    return answer(problem.status, str(problem), problem.parts, request_id, problem.headers)


def install(app: FastAPI, data: str, shortage: Callable[[BaseException], Problem | None]) -> None:
    """Make every exception of a route a problem.

    Args:
        app: The application.
        data: Folder of the service, which answers do not name.
        shortage: The refusal where the system refused something to the service, None where it did not.
    """
    upload = re.compile(rf"{re.escape(data)}/uploads/[^/]+/")

    def without_folder(text: str) -> str:
        text = upload.sub("", text)
        return CONTROL.sub(" ", text.replace(f"{data}/", "").replace(data, "data"))

    def id_of(request: Request) -> str:
        return str(request.scope.get("request_id", ""))

    @app.exception_handler(CoilcalError)
    async def refused(request: Request, error: CoilcalError) -> Response:
        if isinstance(error, Problem):
            return answer_to(error, id_of(request))
        if (problem := shortage(error)) is not None:
            log.error("the system refuses", extra={"fault": str(error), "request_id": id_of(request)})
            return answer_to(problem, id_of(request))
        sentence = without_folder(str(error))
        is_ours = isinstance(error, CorruptStore)  # damage of an upload is `UploadRefused`
        if is_ours:
            log.error("a stored file is damaged", extra={"fault": sentence, "request_id": id_of(request)})
        return answer(500 if is_ours else 422, sentence, parts_of(sentence), id_of(request))

    @app.exception_handler(RequestValidationError)
    async def invalid(request: Request, error: RequestValidationError) -> Response:
        problem = of_validation(error.errors())
        return answer_to(problem, id_of(request))

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> Response:
        if isinstance(error.__cause__, CoilcalError):  # raised while FastAPI read the body
            return await refused(request, error.__cause__)
        words = {404: "must be one that the service has", 405: "must be one that this path takes"}
        thing = {404: "path", 405: "method"}.get(error.status_code, "request")
        value = {404: request.url.path, 405: request.method}.get(error.status_code)
        rule = words.get(error.status_code, f"must be acceptable: {error.detail}")
        headers = dict(error.headers or {})
        if error.status_code == 405:
            headers["Allow"] = ", ".join(_methods(app, request.url.path))
        problem = Problem(error.status_code, thing, rule, value, headers=headers)
        return answer_to(problem, id_of(request))

    @app.exception_handler(ClientDisconnect)
    async def left(request: Request, _: ClientDisconnect) -> Response:
        problem = Problem(400, "body", "must arrive whole; the client has left")
        return answer_to(problem, id_of(request))


def _methods(app: FastAPI, path: str) -> list[str]:
    """Methods that a path takes by all its routes; FastAPI would name those of the first."""
    routes = list(iter_route_contexts(app.routes))
    matching = [route for route in routes if compile_path(str(route.path))[0].match(path)]
    exact = [route for route in matching if route.path == path]  # before one with an id in its place
    return sorted({method for route in exact or matching for method in route.methods or ()})


def failure() -> Problem:
    """The only thing that an answer says of a fault in the service; its log says the rest."""
    return Problem(500, "service", "must answer; it failed, and its log says why under this request's id")


def of_validation(errors: Sequence[Any], where: str | None = None) -> Problem:
    """The refusal of what does not fit its schema, in terms of the first error."""
    first = errors[0]
    place, *path = (str(part) for part in first["loc"]) if first["loc"] else ("body",)
    is_body_missing = first["type"] == "json_invalid"
    thing = place if is_body_missing or not path else ".".join(path)
    message = str(first["msg"])
    rule = f"must be valid: {message[:1].lower()}{message[1:]}"
    value = None if first["type"] in ("missing", "json_invalid") else first.get("input")
    return Problem(422, thing, rule, value, where or place)


RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {
        "description": text,
        "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}},
    }
    for status, text in {
        400: "The request cannot be read.",
        401: "There is no token, or one that is wrong, expired or revoked.",
        403: "The token does not allow this, or the request comes from another site.",
        404: "There is no such thing.",
        405: "The path does not take this method.",
        408: "The body did not arrive in time.",
        409: "It does not fit the state of the thing.",
        413: "It is larger than the service takes.",
        415: "It is of another media type.",
        422: "The content breaks a rule.",
        429: "There is too much to do already; Retry-After says when to ask again.",
        500: "The service failed.",
        503: "The service is starting or stopping, or cannot write its data; it may be asked again.",
        507: "The disk of the service is full; once it has room, the same request is accepted.",
    }.items()
}
