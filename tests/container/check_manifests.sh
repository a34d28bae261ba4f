#!/usr/bin/env bash
# What kubectl kustomize makes of every variant, against Kubernetes' types: tests/container/check_manifests.sh
# Needs kubectl, node, and what deploy/setup.sh --container puts into build/tools/kubernetes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../.."
built=$(mktemp -d)
trap 'rm -rf "$built"' EXIT
for variant in base exec-probes; do
  kubectl kustomize "deploy/kubernetes/$variant" >"$built/$variant.yaml"
done
node tests/container/check_manifests.mjs build/tools/kubernetes/node_modules "$built"/*.yaml
