#!/usr/bin/env bash
# Renews barycast.binpb, the API as clients know it, against which tests/run.sh looks for breaking changes.
# Run it when the API has grown, and commit the result with the change; a change that breaks clients is refused
# unless it is meant: proto/renew_descriptor.sh [--break]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
buf=build/tools/node_modules/.bin/buf
[ -x "$buf" ] || { echo "buf is not installed; run deploy/setup.sh" >&2; exit 1; }
[ "${1:-}" = --break ] || [ ! -f proto/barycast.binpb ] || "$buf" breaking proto --against proto/barycast.binpb
"$buf" build proto --exclude-source-info -o proto/barycast.binpb
