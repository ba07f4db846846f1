"""The service: estimation over HTTP, with jobs that survive a kill. See docs/decisions/0022-service.md."""
