#!/usr/bin/env bash
# The demo, from a fresh machine to a picture: installs, builds, generates a character and a cage, binds the one to the
# other, poses it, and prints the numbers. Everything lands in build/demo/.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
if (($#)); then
  echo "usage: deploy/demo.sh" >&2
  exit 2
fi

python=/usr/bin/python3  # another one earlier on PATH may lack the Debian packages
export PYTHONDONTWRITEBYTECODE=1
demo=build/demo
barycast=build/bin/barycast

say() { printf '\n== %s\n' "$*"; }

# quietly COMMAND...: its output only when it fails.
quietly() {
  local log
  log=$(mktemp)
  if ! "$@" >"$log" 2>&1 </dev/null; then
    cat "$log" >&2
    rm -f "$log"
    exit 1
  fi
  rm -f "$log"
}

say "Setting up"
bash deploy/setup.sh

say "Building (several minutes the first time)"
quietly cmake -S . -B build -G Ninja -DCMAKE_BUILD_TYPE=Release
quietly cmake --build build --target barycastd barycast_command_line barycast_bind_program

say "Generating the character and its cage"
"$python" deploy/demo/generate.py "$demo"

say "Binding"
"$barycast" bind "$demo/cage.obj" "$demo/character.obj" -o "$demo/bind.npz" --gradients --quiet
"$barycast" inspect "$demo/bind.npz" --cage "$demo/cage.obj" --model "$demo/character.obj"

say "Posing"
"$barycast" deform "$demo/bind.npz" "$demo/cage_posed.obj" "$demo/character.obj" -o "$demo/character_posed.obj"

say "Drawing"
"$python" deploy/demo/render.py "$demo/demo.png" --model "$demo/character.obj" --cage "$demo/cage.obj" \
  --posed-model "$demo/character_posed.obj" --posed-cage "$demo/cage_posed.obj"
echo "$PWD/$demo/demo.png"
