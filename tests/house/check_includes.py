#!/usr/bin/env python3
"""Checks the include graph: the layers of core, what core may not know, and where generated headers may appear."""
import fnmatch
import re

import house

INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]', re.MULTILINE)
FOREIGN = ("grpc/", "grpcpp/", "grpc++/", "google/", "spdlog/", "barycast/v1/")
# Where the service meets the wire: decoding (query_assembler puts blocks of points and faces together), encoding, the
# calls (compute_job is one without its transport). Everything else in the server works on values that are valid.
WIRE_FILES = ("decode*", "query_assembler*", "encode*", "service*", "status*", "compute_call*", "compute_job*",
              "upload_call*")
HEALTH = "health.grpc.pb.h"  # the probe's, in daemon.cpp
# The same for the C++ client: what its users include is in include/barycast/client and knows nothing but itself.
CLIENT_WIRE_FILES = ("client.cpp", "compute*", "connection*", "messages*", "request_blocks*", "rpc_status*")
CLIENT_HEADERS = "barycast/client/"


def includes(path):
    return [(mark, name) for mark, name in INCLUDE.findall(path.read_text())]


def check(root):
    violations = []

    def report(path, name, why):
        violations.append(f"{path.relative_to(root)}: includes {name}: {why}")

    for number, layer in enumerate(house.LAYERS):
        allowed = house.LAYERS[:number + 1]
        for path in house.sources(root / "core" / layer):
            for mark, name in includes(path):
                top = name.split("/")[0]
                if name.startswith(FOREIGN) or name.endswith(".pb.h"):
                    report(path, name, "core knows no gRPC, no protobuf and no logging")
                elif top in house.LAYERS and "/" in name:
                    if top not in allowed:
                        report(path, name, f"{layer} may include {', '.join(allowed)}")
                elif mark == '"' and (".." in name or not (path.parent / name).is_file()):
                    report(path, name, "write the layer's folder, as in \"cage/cage.h\"")
    for path in house.sources(root / "server"):
        for _, name in includes(path):
            if (name, path.name) == (HEALTH, "daemon.cpp"):
                continue
            if name.endswith(".pb.h") and not any(fnmatch.fnmatch(path.name, p) for p in WIRE_FILES):
                report(path, name, "generated headers belong to " + ", ".join(WIRE_FILES))
    check_client(root / "client_examples" / "cpp", report)
    return violations


def check_client(folder, report):
    """The C++ client: its public headers, and who may know the wire."""
    public = folder / "include"
    for path in house.sources(folder):
        is_public, is_library = public in path.parents, folder / "src" in path.parents
        for mark, name in includes(path):
            if name.split("/")[0] in (*house.LAYERS, "core", "server"):
                report(path, name, "clients know the API only")
            elif name.startswith(CLIENT_HEADERS):
                if not (public / name).is_file():
                    report(path, name, "there is no such public header")
            elif name.startswith(FOREIGN) or name.endswith(".pb.h"):
                if not is_library or not any(fnmatch.fnmatch(path.name, p) for p in CLIENT_WIRE_FILES):
                    report(path, name, "gRPC and protobuf belong to src/: " + ", ".join(CLIENT_WIRE_FILES))
            elif is_public and mark == '"':
                report(path, name, f"public headers include the standard library and {CLIENT_HEADERS}")
            elif mark == '"' and not (path.parent / name).is_file():
                report(path, name, "includes its own folder and the public headers")


def self_test():
    def violates(files):
        return len(house.found_in(check, files))

    assert violates({"core/bind/a.cpp": '#include "bind/a.h"\n#include "base/b.h"\n#include <vector>\n'}) == 0
    assert violates({"core/cage/a.cpp": '#include "bind/binding.h"\n'}) == 1
    assert violates({"core/cage/a.cpp": '#  include <bind/binding.h>\n'}) == 1
    assert violates({"core/cage/a.cpp": '#include "../bind/binding.h"\n', "core/bind/binding.h": ""}) == 1
    assert violates({"core/cage/a.cpp": '#include "b.h"\n', "core/cage/b.h": ""}) == 0
    assert violates({"core/base/a.h": "#include <spdlog/spdlog.h>\n"}) == 1
    assert violates({"core/bind/a.h": '#include <grpcpp/grpcpp.h>\n#include "barycast/v1/cage.pb.h"\n'}) == 2
    assert violates({"server/decode_cage.cpp": '#include "barycast/v1/cage.pb.h"\n#include "bind/binding.h"\n'}) == 0
    assert violates({"server/cage_cache.h": '#include "barycast/v1/cage.pb.h"\n'}) == 1
    assert violates({"server/daemon.cpp": '#include "health.grpc.pb.h"\n#include "barycast/v1/barycast.pb.h"\n'}) == 1
    assert violates({"client_examples/cpp/a.cpp": '#include "bind/binding.h"\n'}) == 1
    client = "client_examples/cpp/"
    header = {client + "include/barycast/client/a.h": "#include <vector>\n"}
    use = '#include "barycast/client/a.h"\n'
    wire = '#include "barycast/v1/cage.pb.h"\n#include <grpcpp/grpcpp.h>\n'
    assert violates({**header, client + "src/compute.cpp": use + wire, client + "program/main.cpp": use}) == 0
    assert violates({**header, client + "src/cage.cpp": use + wire}) == 2
    assert violates({**header, client + "program/messages.cpp": wire}) == 2
    assert violates({client + "include/barycast/client/client.h": wire}) == 2
    assert violates({client + "src/cage.cpp": use}) == 1
    assert violates({client + "program/a.cpp": '#include "retry.h"\n', client + "src/retry.h": ""}) == 1
    assert violates({client + "include/barycast/client/b.h": '#include "c.h"\n',
                     client + "include/barycast/client/c.h": ""}) == 1


if __name__ == "__main__":
    house.run(check, self_test)
