"""Reads google.rpc error details from the metadata `grpc-status-details-bin`.

The few google.rpc messages are declared here in a private descriptor pool. Their generated modules belong to
the package googleapis-common-protos: importing it would be a dependency, and declaring the same names in the
default pool would break every program that has it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Dict, Iterable, List, Optional, Tuple, Union

from google.protobuf import any_pb2, descriptor_pb2, descriptor_pool, duration_pb2, message_factory
from google.protobuf.message import DecodeError

_KEY = "grpc-status-details-bin"
_Field = descriptor_pb2.FieldDescriptorProto


@dataclass
class Details:
    """What the details said; empty where they said nothing.

    code, message: of the status, as the server sent it. field, description: the first violation of a BadRequest.
    missing: subjects of the PreconditionFailure violations of type MISSING. retry_seconds: of a RetryInfo.
    """

    code: int = 0
    message: str = ""
    field: str = ""
    description: str = ""
    missing: Tuple[str, ...] = ()
    retry_seconds: Optional[float] = None


def _add_field(message: descriptor_pb2.DescriptorProto, number: int, name: str, kind: int, repeated: bool = False,
               type_name: Optional[str] = None) -> None:
    label = _Field.LABEL_REPEATED if repeated else _Field.LABEL_OPTIONAL
    message.field.add(name=name, number=number, type=kind, label=label, type_name=type_name)


def _declare() -> Dict[str, Any]:
    """Message classes by short name: Status, BadRequest, PreconditionFailure, RetryInfo."""
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(any_pb2.DESCRIPTOR.serialized_pb)
    pool.AddSerializedFile(duration_pb2.DESCRIPTOR.serialized_pb)
    file = descriptor_pb2.FileDescriptorProto(name="barycast/google_rpc_private.proto", package="google.rpc",
                                              syntax="proto3")
    file.dependency.extend([any_pb2.DESCRIPTOR.name, duration_pb2.DESCRIPTOR.name])

    status = file.message_type.add(name="Status")
    _add_field(status, 1, "code", _Field.TYPE_INT32)
    _add_field(status, 2, "message", _Field.TYPE_STRING)
    _add_field(status, 3, "details", _Field.TYPE_MESSAGE, True, ".google.protobuf.Any")

    bad_request = file.message_type.add(name="BadRequest")
    violation = bad_request.nested_type.add(name="FieldViolation")
    for number, name in enumerate(("field", "description"), 1):
        _add_field(violation, number, name, _Field.TYPE_STRING)
    _add_field(bad_request, 1, "field_violations", _Field.TYPE_MESSAGE, True, ".google.rpc.BadRequest.FieldViolation")

    failure = file.message_type.add(name="PreconditionFailure")
    violation = failure.nested_type.add(name="Violation")
    for number, name in enumerate(("type", "subject", "description"), 1):
        _add_field(violation, number, name, _Field.TYPE_STRING)
    _add_field(failure, 1, "violations", _Field.TYPE_MESSAGE, True, ".google.rpc.PreconditionFailure.Violation")

    retry = file.message_type.add(name="RetryInfo")
    _add_field(retry, 1, "retry_delay", _Field.TYPE_MESSAGE, False, ".google.protobuf.Duration")

    pool.Add(file)
    names = [message.name for message in file.message_type]
    descriptors = [pool.FindMessageTypeByName(f"google.rpc.{name}") for name in names]
    if hasattr(message_factory, "GetMessageClass"):  # protobuf 4.22 and later
        classes = [message_factory.GetMessageClass(descriptor) for descriptor in descriptors]
    else:
        factory = message_factory.MessageFactory(pool)
        classes = [factory.GetPrototype(descriptor) for descriptor in descriptors]
    return dict(zip(names, classes))


MESSAGES = _declare()


def decode(metadata: Iterable[Tuple[str, Union[str, bytes]]]) -> Details:
    """Details in a call's trailing metadata. Bytes that are no google.rpc.Status count as no details, since the
    status itself still says what happened."""
    details = Details()
    missing: List[str] = []
    for key, value in metadata:
        if key != _KEY:
            continue
        try:
            status = MESSAGES["Status"].FromString(value)
            details.code, details.message = status.code, status.message
            for item in status.details:
                _read(item, details, missing)
        except DecodeError:
            continue
    details.missing = tuple(missing)
    return details


def _read(item: Any, details: Details, missing: List[str]) -> None:
    name = item.type_url.rsplit("/", 1)[-1]
    if name == "google.rpc.BadRequest":
        violations = MESSAGES["BadRequest"].FromString(item.value).field_violations
        if violations and not details.field:
            details.field, details.description = violations[0].field, violations[0].description
    elif name == "google.rpc.PreconditionFailure":
        violations = MESSAGES["PreconditionFailure"].FromString(item.value).violations
        missing.extend(violation.subject for violation in violations if violation.type == "MISSING")
    elif name == "google.rpc.RetryInfo":
        delay = MESSAGES["RetryInfo"].FromString(item.value).retry_delay
        details.retry_seconds = delay.seconds + 1e-9 * delay.nanos
