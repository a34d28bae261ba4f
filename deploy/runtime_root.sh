#!/usr/bin/env bash
# The file system of the container: runtime_root.sh PROGRAM FOLDER
# The program, stripped; its dynamic closure, each object where the loader looks for it; for the packages that these
# come from their licences, and their dpkg records as scanners of images read them; an unprivileged user.
set -euo pipefail
program=$1 root=$2

install -D -m 755 "$program" "$root/usr/bin/barycastd"
strip "$root/usr/bin/barycastd"
install -D -m 644 LICENSE "$root/usr/share/doc/barycastd/LICENSE"

# Debian 12 has /lib in /usr, and so has this.
mkdir -p "$root"/usr/lib "$root"/usr/lib64 "$root"/etc "$root"/var/lib/dpkg/status.d
ln -s usr/lib "$root/lib"
ln -s usr/lib64 "$root/lib64"

closure=$(ldd "$program")
if grep -F 'not found' <<<"$closure" >&2; then exit 1; fi
grep -o '/[^ ]*' <<<"$closure" | while read -r object; do
  file=$(readlink -f "$object")
  install -D -m 755 "$file" "$root/$object"
  # dpkg knows some by the name that they had before /lib moved.
  dpkg-query -S "$file" 2>/dev/null || dpkg-query -S "${file#/usr}"
done | cut -d: -f1 | sort -u >/tmp/packages

while read -r package; do
  install -D -m 644 "/usr/share/doc/$package/copyright" "$root/usr/share/doc/$package/copyright"
  dpkg-query -s "$package" >"$root/var/lib/dpkg/status.d/$package"
done </tmp/packages

cp /etc/os-release "$root/etc/os-release"
echo 'barycastd:x:65532:65532::/:/nonexistent' >"$root/etc/passwd"
echo 'barycastd:x:65532:' >"$root/etc/group"
