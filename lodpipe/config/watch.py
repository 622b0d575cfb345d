"""The `watch` section: how the daemon treats its drop folder. Nothing in it changes what is published."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

Seconds = Annotated[float, Field(ge=0)]


class Part(BaseModel):
    """A part of the configuration: frozen, and unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True)


class Hook(Part):
    """What to call when an asset is done or has failed; nothing by default."""

    command: tuple[str, ...] = ()
    """A program and its arguments. No shell sees them; the facts come as LODPIPE_… variables and as JSON on stdin."""
    webhook: str = ""
    """An http or https address that gets the facts as JSON by POST."""
    timeout_s: Annotated[float, Field(gt=0)] = 30.0
    """How long it may take."""

    @field_validator("webhook")
    @classmethod
    def _is_http(cls, webhook: str) -> str:
        if webhook and not webhook.startswith(("http://", "https://")):
            raise ValueError(f"must begin with http:// or https:// (got '{webhook}')")
        return webhook

    @property
    def wanted(self) -> bool:
        """Whether there is anything to call."""
        return bool(self.command or self.webhook)


class Watch(Part):
    """The daemon's drop folder; `run` does not look at it."""

    settle_s: Seconds = 2.0
    """How long all files of an asset must have stayed the same before it is taken."""
    closed_s: Seconds = 0.5
    """The same where a file event has told that its writer has closed it, or has renamed it to its name, since it last
    changed; never longer than `settle_s`."""
    rescan_s: Annotated[float, Field(gt=0)] = 60.0
    """Longest time between two looks at the whole folder, whatever events say."""
    events: Literal["auto", "on", "off"] = "auto"
    """Whether the system's file events wake the daemon; auto: where the file system has them (not NFS, SMB, FUSE)."""
    poll_s: Annotated[float, Field(gt=0)] = 5.0
    """Time between two looks at the folder where there are no events."""
    wait_s: Seconds = 300.0
    """How long to wait for files that an asset names and that are not there."""
    missing: Literal["quarantine", "process"] = "quarantine"
    """What to do then: fail the asset, or process it without them (with warnings)."""
    ignore: tuple[str, ...] = ()
    """Globs of files and folders to leave alone, besides hidden and temporary ones."""
    priorities: dict[str, int] = {}
    """Glob → minutes by which matching assets go ahead of others; negative: behind."""
    same_content: Literal["skip", "publish"] = "skip"
    """What to do with a file whose content is published under another name (a copy, a file renamed)."""
    attempts: Annotated[int, Field(ge=1)] = 2
    """How often an asset that crashes, runs out of time or of memory is tried."""
    on_success: Literal["keep", "move", "delete"] = "keep"
    """What becomes of an asset's files once its result is published and verified."""
    on_removed: Literal["keep", "archive"] = "keep"
    """What becomes of a result whose asset has disappeared."""
    drain_s: Seconds = 60.0
    """How long running jobs may go on after SIGTERM."""
    workers: Annotated[int, Field(ge=1)] = 1
    """Assets at a time."""
    executor: str = "local"
    """Where jobs run: `local`, `dask`, or the name of a plug-in."""
    scheduler: str = ""
    """Address of the scheduler, for executors that have one: tcp://farm:8786."""
    port: Annotated[int, Field(ge=0, le=65535)] | None = None
    """Port on 127.0.0.1 of the status page, /healthz and /metrics; 0: any that is free. None: no page."""
    on_done: Hook = Hook()
    on_failed: Hook = Hook()


class Cache(Part):
    """Results of stages that are kept, so that a change late in the chain does not redo what comes before it."""

    gb: Annotated[float, Field(ge=0)] = 2.0
    """Most disk space for them, in the output folder's `.lodpipe`; 0: none are kept."""
    min_seconds: Seconds = 0.5
    """Results that took less are made anew instead."""
