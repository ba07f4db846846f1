"""The application: routes, what every request passes before them, and what begins and ends with the process."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import import_module
from importlib.metadata import version
from pkgutil import iter_modules
from typing import Any

from fastapi import FastAPI
from fastapi.dependencies.models import Dependant
from fastapi.routing import APIRoute, iter_route_contexts
from starlette.concurrency import run_in_threadpool
from starlette.middleware.gzip import GZipMiddleware
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from estimator.service import routes
from estimator.service.core import Core
from estimator.service.guard import PUBLIC, Guard
from estimator.service.ownership import OWNED
from estimator.service.page_files import page_router
from estimator.service.problems import RESPONSES, ProblemBody, install
from estimator.service.requests import Needs, Reader
from estimator.service.settings import Settings
from estimator.service.storage import shortage
from estimator.service.tokens import Scope

SMALLEST_GZIPPED = 1_000  # bytes
GZIP_LEVEL = 1  # digits hardly shrink further, and a higher level takes ten times as long
DESCRIPTION = "Calibration of electromagnet coils, with credible intervals. Numbers are in SI."


def create_app(settings: Settings, has_workers: bool = True) -> FastAPI:
    """The service as an ASGI application; it takes the data folder at once, and gives it back when it is shut down.

    Args:
        settings: How it runs.
        has_workers: False leaves jobs in the queue.
    Raises:
        InvalidInput: The data folder cannot be used.
    """
    core = Core(settings)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        if has_workers:
            core.start()
        yield
        await run_in_threadpool(core.close)

    app = FastAPI(
        title="coilcal",
        version=version("coilcal"),
        description=DESCRIPTION,
        lifespan=lifespan,
        responses=RESPONSES,
        docs_url=None,  # they load scripts from elsewhere
        redoc_url=None,
        openapi_url=None,
        redirect_slashes=False,
    )
    app.state.core = core
    for module in iter_modules(routes.__path__):
        app.include_router(import_module(f"{routes.__name__}.{module.name}").router)
    app.include_router(page_router())
    install(app, str(core.data), shortage)
    _add_schema(app)
    app.add_middleware(GZipMiddleware, minimum_size=SMALLEST_GZIPPED, compresslevel=GZIP_LEVEL)
    app.add_middleware(
        Guard, settings=settings, database=core.database, cookies=core.cookies, metrics=core.metrics
    )
    if settings.proxies:  # outermost, so that all others see the client and its scheme, not the proxy's
        app.add_middleware(ProxyHeadersMiddleware, trusted_hosts=list(settings.proxies))
    unguarded = [
        path for path, scope in scopes_by_route(app).items() if scope is None and path[1] not in PUBLIC
    ]
    if unguarded:
        raise RuntimeError(f"every route must ask for a scope; {unguarded} do not")
    open_to_all = [path for path, is_owned in _changes(app).items() if not is_owned]
    if open_to_all:
        raise RuntimeError(f"every route that changes something must ask whose it is; {open_to_all} do not")
    return app


def scopes_by_route(app: FastAPI) -> dict[tuple[str, str], Scope | None]:
    """Scope that each method and path asks for; None where it asks for none, or cannot say so."""
    scopes: dict[tuple[str, str], Scope | None] = {}
    for context in iter_route_contexts(app.routes):
        route = context.original_route
        scope = _scope_of(route.dependant) if isinstance(route, APIRoute) else None
        for method in sorted(context.methods or {"any"}):
            scopes[method, str(context.path)] = scope
    return scopes


def _scope_of(dependant: Dependant) -> Scope | None:
    """The strongest scope that a route asks for by itself, by its router, or by what it depends on."""
    scopes = [
        part.call.scope if isinstance(part.call, Needs) else _scope_of(part)
        for part in dependant.dependencies
    ]
    return max(filter(None, scopes), key=list(Scope).index, default=None)


def _changes(app: FastAPI) -> dict[tuple[str, str], bool]:
    """Methods and paths with which writers change what a path names, and whether each asks whose it is."""
    asked: dict[tuple[str, str], bool] = {}
    for context in iter_route_contexts(app.routes):
        route = context.original_route
        if isinstance(route, APIRoute) and "{" in route.path and _scope_of(route.dependant) is Scope.WRITE:
            is_owned = any(part.call in OWNED for part in route.dependant.dependencies)
            asked |= {(method, str(context.path)): is_owned for method in sorted(context.methods or ())}
    return asked


def _add_schema(app: FastAPI) -> None:
    """Serve the OpenAPI schema, which has the form of refusals and the tokens too."""

    @app.get("/v1/openapi.json", include_in_schema=False)
    def openapi(caller: Reader) -> dict[str, Any]:  # noqa: ARG001
        return app.openapi()

    make = app.openapi

    def schema() -> dict[str, Any]:
        if app.openapi_schema is None:
            made = make()
            components = made.setdefault("components", {})
            components.setdefault("schemas", {})["Problem"] = ProblemBody.model_json_schema()
            components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
            made["security"] = [{}, {"token": []}]  # none at loopback
        return app.openapi_schema or make()

    app.openapi = schema  # type: ignore[method-assign]
