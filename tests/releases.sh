#!/usr/bin/env bash
# Tests the last commit on releases of Debian, each with its own dolfinx, PETSc, Open MPI and Python, and prints a table:
#   tests/releases.sh [RELEASE...] [-- ARGUMENTS OF PYTEST]      bookworm, trixie and sid, if none is named
# The release of this machine is tested in this clone. Each other one has a root, 3 to 4 GB, made at the first call from the
# archive that apt knows here, and kept: in $OBSTACLE_ROOTS, or in ~/.cache/fenicsx_obstacle/releases.
set -euo pipefail
trap 'exit 130' INT TERM

here=$(dirname "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")")
roots=${OBSTACLE_ROOTS:-${XDG_CACHE_HOME:-$HOME/.cache}/fenicsx_obstacle/releases}
this=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
copy=/root/fenicsx_obstacle # of the commit, in a root

fail() {
  echo "releases: $1" >&2
  exit 1
}

# within RELEASE COMMAND...: runs it in the clone, or in the copy of that release. What is mounted and started for a root
# lives in name spaces of its own, which end with the command, however it ends.
within() {
  if [ "$1" = "$this" ]; then
    (cd "$here" && "${@:2}")
    return
  fi
  # shellcheck disable=SC2016
  unshare --mount --pid --fork --kill-child bash -euc '
    mount -t proc proc "$0/proc"
    mount --rbind /sys "$0/sys"
    mount --rbind /dev "$0/dev"
    # Open MPI names its segments and folders by host and process, and processes are counted anew here: what another run
    # has there, or what one that was killed has left there, must not be met
    mount -t tmpfs tmpfs "$0/dev/shm"
    mount -t tmpfs tmpfs "$0/tmp"
    exec chroot "$0" env -i HOME=/root LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin bash -c "cd \"\$0\" && exec \"\$@\"" "$@"
  ' "$roots/$1" "$copy" "${@:2}"
}

make_root() {
  [ ! -d "$roots/$1" ] || return 0
  local archive
  archive=$(apt-get indextargets --format '$(REPO_URI)' 'Identifier: Packages' 'Label: Debian' | head -n 1)
  [ -n "$archive" ] || fail "apt knows no archive of Debian here; after apt-get update it may"
  echo "making $roots/$1 from $archive" >&2
  rm -rf "$roots/$1.new"
  mkdir -p "$roots"
  unshare --mount debootstrap --variant=minbase --include=ca-certificates "$1" "$roots/$1.new" "$archive" >&2 ||
    fail "debootstrap could not make $1"
  mv "$roots/$1.new" "$roots/$1"
}

# fill_root RELEASE: the last commit with all that it needs: from Debian alone, if that has it, else as ./obstacle does it
fill_root() {
  local root=$roots/$1
  cp --remove-destination --dereference /etc/resolv.conf /etc/hosts "$root/etc/"
  rm -rf "${root:?}$copy"
  mkdir -p "$root$copy"
  git -C "$here" archive HEAD | tar -xC "$root$copy"
  within "$1" bash -euc '
    export DEBIAN_FRONTEND=noninteractive
    # a mirror of sid may be older than sid allows
    apt-get update -q -o Acquire::Check-Valid-Until=false
    if apt-get install -y -q --no-install-recommends $(cat debian-packages.txt debian-packages-python.txt debian-packages-test.txt); then
      python3 -m venv --system-site-packages .venv
      .venv/bin/pip install --quiet --no-build-isolation --no-deps --editable .
      touch .venv/image
    fi
    apt-get clean
    ./obstacle --version' >&2 || fail "what the tests need could not be installed on $1"
}

releases=()
while [ $# -gt 0 ] && [ "$1" != -- ]; do
  [[ "$1" =~ ^[a-z]+$ ]] || fail "names of releases come first, then -- and what pytest is to know; $1 is no name"
  releases+=("$1")
  shift
done
[ $# -eq 0 ] || shift
[ ${#releases[@]} -gt 0 ] || releases=(bookworm trixie sid)
for release in "${releases[@]}"; do
  [ "$release" != "$this" ] || continue
  [ "$(id -u)" -eq 0 ] && command -v debootstrap >/dev/null || # shellcheck disable=SC2015
    fail "$release is not the release of this machine: a root for it needs debootstrap, and the user root"
done
git -C "$here" diff --quiet HEAD || fail "the last commit is tested, and there are changes after it: commit them first"

versions='import platform, dolfinx; from mpi4py import MPI; from petsc4py import PETSc
library = MPI.Get_library_version().split(",")[0].replace(" v", " ")
print(dolfinx.__version__, ".".join(map(str, PETSc.Sys.getVersion())), library, platform.python_version(), sep=" | ")'
table="| release | dolfinx | PETSc | MPI | Python | 1 rank | 2 ranks | 3 ranks |
|---|---|---|---|---|---|---|---|"
log=$(mktemp)
trap 'rm -f "$log"' EXIT
status=0
for release in "${releases[@]}"; do
  if [ "$release" = "$this" ]; then
    "$here/obstacle" --version >&2
  else
    make_root "$release"
    fill_root "$release"
  fi
  row="| $release | $(within "$release" .venv/bin/python -c "$versions" 2>/dev/null)"
  for ranks in 1 2 3; do
    echo "$release, $ranks rank$([ "$ranks" = 1 ] || echo s)" >&2
    within "$release" ./obstacle --ranks "$ranks" test --all "$@" 2>&1 | tee "$log" >&2 || status=1
    # pytest's last line, without what was not asked of this number of ranks
    outcome=$(grep -E '^[0-9]+ [a-z]+.* in [0-9.]+s' "$log" | tail -n 1 | sed -E 's/, [0-9]+ (deselected|warnings?)//g; s/ in /, /; s/ \(.*//')
    row+=" | ${outcome:-broken off}"
  done
  table+=$'\n'"$row |"
done
echo "$(git -C "$here" log -1 --format='%h, %cs')"
echo "$table"
exit "$status"
