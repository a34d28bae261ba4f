"""Exceptions from failed calls: code, field, message, and which class."""

import fake_server
import grpc
import pytest
from fake_server import bad_request, status_bytes
from google.protobuf import descriptor_pool

from barycast import InputError, MissingCageError, ServerError, rpc_details
from barycast.errors import from_rpc_error


class FakeError(grpc.RpcError):
    def __init__(self, code, message, *details, raw=None):
        self._code, self._message = code, message
        value = raw if raw is not None else status_bytes(code.value[0], message, *details)
        self._metadata = (("other", "x"), ("grpc-status-details-bin", value))

    def code(self):
        return self._code

    def details(self):
        return self._message

    def trailing_metadata(self):
        return self._metadata


def test_field_at_fault():
    description = "index 57 >= 40 control vertices"
    field = "cage.quads[12].vertex[3]"
    error = from_rpc_error(FakeError(grpc.StatusCode.INVALID_ARGUMENT, f"{field}: {description}",
                                     bad_request(field, description)))
    assert isinstance(error, InputError)
    assert (error.code, error.field, error.message) == ("INVALID_ARGUMENT", field, description)
    assert str(error) == f"{field}: {description}"


def test_the_field_is_not_said_twice():
    error = InputError("cage.quads[12]: has no area", field="cage.quads[12]")
    assert str(error) == "cage.quads[12]: has no area"


def test_missing_cage():
    failure = rpc_details.MESSAGES["PreconditionFailure"]()
    failure.violations.add(type="MISSING", subject="ab" * 32)
    assert isinstance(from_rpc_error(FakeError(grpc.StatusCode.FAILED_PRECONDITION, "no", failure)), MissingCageError)
    failure.violations[0].type = "NUMERICS_VERSION"
    assert isinstance(from_rpc_error(FakeError(grpc.StatusCode.FAILED_PRECONDITION, "no", failure)), ServerError)


def test_busy_is_not_too_large():
    retry = rpc_details.MESSAGES["RetryInfo"]()
    retry.retry_delay.seconds, retry.retry_delay.nanos = 1, 500_000_000
    busy = from_rpc_error(FakeError(grpc.StatusCode.RESOURCE_EXHAUSTED, "busy", retry))
    assert isinstance(busy, ServerError) and busy.retry_seconds == 1.5
    assert isinstance(from_rpc_error(FakeError(grpc.StatusCode.RESOURCE_EXHAUSTED, "too large")), InputError)


@pytest.mark.parametrize("raw", [b"", b"\xff\xff\xff", b"\x1a\x04\x12\x02\xff\xff"])
def test_broken_details_leave_the_status(raw):
    error = from_rpc_error(FakeError(grpc.StatusCode.INVALID_ARGUMENT, "said here", raw=raw))
    assert (error.code, error.field, error.message) == ("INVALID_ARGUMENT", "", "said here")


def test_the_default_pool_stays_clean():
    for name in rpc_details.MESSAGES:
        with pytest.raises(KeyError):
            descriptor_pool.Default().FindMessageTypeByName(f"google.rpc.{name}")
    assert fake_server.status_bytes(3, "x")  # encodes without them


@pytest.mark.parametrize("code, message", [
    (grpc.StatusCode.UNKNOWN, "Stream removed"),
    (grpc.StatusCode.INTERNAL, "Received RST_STREAM with error code 2"),
    (grpc.StatusCode.CANCELLED, "Received RST_STREAM with error code 8"),
])
def test_a_stream_that_a_proxy_lost_is_a_lost_connection(code, message):
    error = from_rpc_error(FakeError(code, message, raw=b""))
    assert isinstance(error, ServerError)
    assert (error.code, error.message) == ("UNAVAILABLE", f"the connection was lost ({message})")
    assert from_rpc_error(FakeError(code, "something else", raw=b"")).code == code.name
    refused = from_rpc_error(FakeError(code, message, raw=status_bytes(3, "a: is wrong", bad_request("a", "is wrong"))))
    assert isinstance(refused, InputError)
    assert (refused.code, refused.field, refused.message) == ("INVALID_ARGUMENT", "a", "is wrong")
