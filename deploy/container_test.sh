#!/usr/bin/env bash
# Builds the container and runs it, as root on Debian 12: deploy/container_test.sh
# Installs what it needs (deploy/setup.sh --container), lints what is deployed, makes a Debian base image by this
# machine's own apt sources, builds the image on it, and checks it as tests/container/run.py says. A line per step; the
# first that fails ends it. Images and build caches stay, so that a second run takes two or three minutes.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
if (($#)); then
  echo "usage: deploy/container_test.sh" >&2
  exit 2
fi

python=/usr/bin/python3  # another one earlier on PATH may lack the Debian packages
base=localhost/barycast-test/debian image=localhost/barycast-test/barycastd:latest
image_mb_max=80  # the dynamic closure is 71, and 44 of that are Embree
export PYTHONDONTWRITEBYTECODE=1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

say() { printf '%-12s %s\n' "$1" "$2"; }

# step NAME COMMAND...: its output when it fails; sets `seconds`.
step() {
  local name=$1 start=$SECONDS status
  shift
  # Not "|| status=$?": a command tested that way would run on after its first failure.
  set +e
  (set -e; "$@") >"$work/log" 2>&1 </dev/null
  status=$?
  set -e
  if ((status)); then
    cat "$work/log" >&2
    say "$name" "FAILED with $status: see above"
    exit 1
  fi
  seconds=$((SECONDS - start))
}

# Networks of the host and no systemd: what also works within another container or a bare virtual machine.
export CONTAINERS_CONF=$work/containers.conf
cat >"$CONTAINERS_CONF" <<'CONF'
[containers]
default_ulimits = ["nofile=16384:16384", "nproc=4096:4096"]
netns = "host"
log_driver = "k8s-file"
[engine]
runtime = "runc"
cgroup_manager = "cgroupfs"
events_logger = "file"
CONF

host_build() {
  cmake -S . -B build -G Ninja -DCMAKE_BUILD_TYPE=Release
  cmake --build build -j "$(nproc)" --target barycastd barycast_command_line
}

lint() {
  local haproxy
  haproxy=$(PATH=$PATH:/usr/sbin command -v haproxy)
  shellcheck deploy/*.sh tests/container/*.sh
  yamllint --strict deploy
  build/tools/kubernetes/node_modules/.bin/dockerfilelint deploy/Containerfile
  BARYCAST_LISTEN=127.0.0.1:1 REPLICA_A=127.0.0.1:2 REPLICA_B=127.0.0.1:3 "$haproxy" -c -f deploy/haproxy.cfg
}

# Debian's sources and proxies as this machine's apt has them; the image keeps them for the build.
base_image() {
  # shellcheck disable=SC2016  # apt fills these in
  apt-get indextargets --format 'deb $(REPO_URI) $(RELEASE) $(COMPONENT)' 'Created-By: Packages' 'Origin: Debian' \
    | sort -u >"$work/sources.list"
  [ -s "$work/sources.list" ] || { echo "apt knows no Debian sources; run apt-get update"; return 1; }
  apt-config dump --format '%F "%v";%n' Acquire::http::Proxy Acquire::https::Proxy >"$work/apt.conf"
  mmdebstrap --quiet --variant=minbase --include=ca-certificates --aptopt="$work/apt.conf" bookworm "$work/base.tar" \
    "$work/sources.list"
  podman import --quiet "$work/base.tar" "$base:bookworm-slim"
}

build_image() {
  podman build --format docker --network host -f deploy/Containerfile --build-arg DEBIAN="$base" \
    --build-arg JOBS="$(nproc)" --label org.opencontainers.image.revision="$(git rev-parse HEAD)" \
    --label org.opencontainers.image.created="$(date -u +%FT%TZ)" -t "$image" .
}

step setup bash deploy/setup.sh --container
say setup "$(podman --version), $(qemu-x86_64 --version | head -n 1)"
step host-build host_build
say host-build "$seconds s, $(build/bin/barycastd --version)"
step lint lint
say lint "shell, YAML, Containerfile, haproxy.cfg"
step manifests tests/container/check_manifests.sh
say manifests "kubectl kustomize: $(tail -n 1 "$work/log") of Kubernetes' types"
if podman image exists "$base:bookworm-slim"; then
  say base "kept from an earlier run"
else
  step base base_image
  say base "$seconds s, $(($(podman image inspect --format '{{.Size}}' "$base:bookworm-slim") / 1000000)) MB"
fi
previous=$(podman image inspect --format '{{.Id}}' "$image" 2>/dev/null || true)
step image build_image
size=$(podman image inspect --format '{{.Size}}' "$image")
say image "$seconds s, $((size / 1000000)).$((size / 100000 % 10)) MB"
if ((size > image_mb_max * 1000000)); then
  say image "FAILED: more than $image_mb_max MB"
  exit 1
fi
if [ -n "$previous" ] && [ "$previous" != "$(podman image inspect --format '{{.Id}}' "$image")" ]; then
  podman rmi "$previous" >/dev/null 2>&1 || true  # another tag may hold it
fi

# In the background, so that a signal reaches it, and its containers go.
"$python" tests/container/run.py "$image" build </dev/null &
checks=$!
trap 'kill "$checks"' INT TERM
status=0
wait "$checks" || status=$?
if ((status > 128)); then wait "$checks" || status=$?; fi  # a signal ended the first wait
if ((status)); then exit "$status"; fi
say all "passed in $SECONDS s"
