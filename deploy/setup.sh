#!/usr/bin/env bash
# Installs what building, testing and the demo need on Debian 12, where it is missing; a second run does nothing.
#   --daemon      only what building barycastd needs
#   --container   also what deploy/container_test.sh needs
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

mode=${1:-}
case "$#$mode" in
  0 | 1--daemon | 1--container) ;;
  *) echo "usage: deploy/setup.sh [--daemon | --container]" >&2; exit 2 ;;
esac

packages=(
  g++ cmake ninja-build ccache pkg-config
  libgrpc++-dev protobuf-compiler protobuf-compiler-grpc libprotobuf-dev grpc-proto
  libembree-dev libtbb-dev libspdlog-dev libfmt-dev libeigen3-dev libcli11-dev libssl-dev libhwy-dev zlib1g-dev
  nlohmann-json3-dev prometheus-cpp-dev
)
[ "$mode" = --daemon ] || packages+=(
  libgtest-dev libgmock-dev clang libclang-rt-14-dev clang-format clang-tidy
  python3-grpcio python3-protobuf python3-numpy python3-scipy python3-pytest python3-matplotlib python3-tqdm
  python3-venv python3-pip python3-setuptools python3-wheel
  haproxy yamllint
)
if [ "$mode" = --container ]; then
  packages+=(podman podman-compose runc catatonit containernetworking-plugins iptables mmdebstrap shellcheck qemu-user)
  command -v npm >/dev/null || packages+=(npm)  # where it comes from elsewhere, it stays
  if ! command -v kubectl >/dev/null; then
    echo "setup: kubectl 1.22 or later must be on PATH; Debian 12 packages none (kubernetes-client is 1.20)" >&2
    exit 1
  fi
fi

installed=$(dpkg-query -W -f='${Package} ${db:Status-Status}\n' "${packages[@]}" 2>/dev/null \
  | sed -n 's/ installed$//p' || true)
missing=()
for package in "${packages[@]}"; do
  grep -qxF "$package" <<<"$installed" || missing+=("$package")
done
if ((${#missing[@]})); then
  echo "setup: installing ${missing[*]}"
  root=()
  [ "$(id -u)" -eq 0 ] || root=(sudo)
  export DEBIAN_FRONTEND=noninteractive
  "${root[@]}" apt-get update -qq </dev/null
  "${root[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}" </dev/null >/dev/null
fi

[ "$mode" != --daemon ] || exit 0

# buf lints the API and guards it against breaking changes. It is not packaged for Debian, so it comes from npm and is optional.
if [ ! -x build/tools/node_modules/.bin/buf ]; then
  if ! command -v npm >/dev/null; then
    echo "setup: npm is absent, so buf is not installed and the API will not be checked"
  elif mkdir -p build/tools \
    && npm install --silent --no-fund --no-audit --prefix build/tools '@bufbuild/buf@1' </dev/null; then
    echo "setup: installed buf $(build/tools/node_modules/.bin/buf --version)"
  else
    echo "setup: npm could not install buf, so the API will not be checked"
  fi
fi

# The types of Kubernetes' API, what reads and checks them, and a linter of Containerfiles.
modules=(kubernetes-models@5.1.0 typescript@5.9.3 yaml@2.9.1 dockerfilelint@1.8.0)
if [ "$mode" = --container ] && [ "$(cat build/tools/kubernetes/installed 2>/dev/null)" != "${modules[*]}" ]; then
  mkdir -p build/tools/kubernetes
  npm install --silent --no-fund --no-audit --save-exact --prefix build/tools/kubernetes "${modules[@]}" </dev/null
  echo "${modules[*]}" >build/tools/kubernetes/installed
  echo "setup: installed ${modules[*]}"
fi
