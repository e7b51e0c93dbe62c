#!/bin/sh
# Builds the image and runs the service with a real Docker engine of its own, from nothing: starts dockerd without a
# bridge network, makes a base image with debootstrap where no image registry can be reached, builds, brings the service
# up, watches it, kills its worker, takes it down. Needs root, dockerd, debootstrap, docker compose, and a streamlod
# environment to make a clip with.
#
#   docker/test_engine.sh [PYTHON]        PYTHON: interpreter of that environment (default .venv/bin/python)
#
# BASE_IMAGE=name uses an image that the engine can pull; COMPOSE names the compose command; PORT (8000) must be free;
# WORK=folder keeps scratch files and the base image for the next run.
set -eu
cd "$(dirname "$0")/.."
PYTHON=${1:-.venv/bin/python}
COMPOSE=${COMPOSE:-docker compose}
KEEP=${WORK:-}
WORK=${WORK:-$(mktemp -d)}
mkdir -p "$WORK/clip"
chmod 755 "$WORK" "$WORK/clip"
DOCKER_HOST=unix://$WORK/docker.sock
DOCKER_BUILDKIT=0
COMPOSE_DOCKER_CLI_BUILD=0
CLIP_FOLDER=$WORK/clip
PORT=${PORT:-8000}
export PORT DOCKER_HOST DOCKER_BUILDKIT COMPOSE_DOCKER_CLI_BUILD CLIP_FOLDER
files="-f docker/compose.yaml -f docker/compose.ci.yaml"

dockerd --data-root "$WORK/data" --exec-root "$WORK/exec" --pidfile "$WORK/pid" -H "$DOCKER_HOST" \
    --storage-driver=overlay2 --iptables=false --ip6tables=false --bridge=none \
    --exec-opt native.cgroupdriver=cgroupfs >"$WORK/dockerd.log" 2>&1 &
engine=$!
finish() {
    status=$?
    [ $status -eq 0 ] || $COMPOSE $files logs --tail 30 2>/dev/null || true
    $COMPOSE $files down --volumes --timeout 12 >/dev/null 2>&1 || true
    kill "$engine" 2>/dev/null || true
    wait "$engine" 2>/dev/null || true
    [ -n "$KEEP" ] || rm -rf "$WORK"
    exit $status
}
trap finish EXIT
tries=0
until docker info >/dev/null 2>&1; do
    tries=$((tries + 1))
    [ $tries -lt 60 ] || { tail -5 "$WORK/dockerd.log"; echo "dockerd did not start" >&2; exit 1; }
    sleep 0.5
done

if [ -z "${BASE_IMAGE:-}" ]; then
    BASE_IMAGE=streamlod/python:3.11
    if ! docker image inspect "$BASE_IMAGE" >/dev/null 2>&1; then
        root=$WORK/base
        [ -d "$root/usr" ] || debootstrap --variant=minbase \
            --include=python3,python3-venv,ca-certificates bookworm "$root" >"$WORK/debootstrap.log"
        # a package mirror and certificates that this machine is set up with hold inside as well
        cp /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
        [ ! -f /etc/pip.conf ] || cp /etc/pip.conf "$root/etc/pip.conf"
        # what Debian's image of Python leaves out, too
        tar -C "$root" --exclude=./var/cache/apt --exclude=./var/lib/apt/lists --exclude=./usr/share/doc \
            --exclude=./usr/share/man --exclude=./usr/share/locale -c . | docker import - "$BASE_IMAGE" >/dev/null
    fi
fi

"$PYTHON" - "$WORK/clip/scene.slod" <<'CLIP'
import sys
from pathlib import Path
from tests.server.conftest import make_clip
make_clip(Path(sys.argv[1]), 200, key_every=100)
CLIP
printf '[[streams]]\nplay = "/clip/scene.slod"\n' >"$WORK/clip/server.toml"
chmod 644 "$WORK/clip/scene.slod" "$WORK/clip/server.toml"

docker build --network host --build-arg BASE_IMAGE="$BASE_IMAGE" --build-arg EXTRAS=serve -t streamlod:ci \
    -f docker/Dockerfile .
megabytes=$(($(docker image inspect --format '{{.Size}}' streamlod:ci) / 1000000))
echo "image: $megabytes MB"
[ $megabytes -lt 700 ] || { echo "the image that only plays is larger than 700 MB" >&2; exit 1; }

# a host folder that belongs to root, as docker makes one that is missing: one sentence, and no traceback
mkdir -p "$WORK/roots"
chown 0:0 "$WORK/roots"
chmod 755 "$WORK/roots"
if docker run --rm --network none -v "$WORK/roots:/data" streamlod:ci >"$WORK/refused" 2>&1; then
    echo "a folder that cannot be written was taken" >&2
    exit 1
fi
cat "$WORK/refused"
tail -1 "$WORK/refused" | grep -q "give the folder to user 10001" || { echo "not refused in one sentence" >&2; exit 1; }
! grep -q Traceback "$WORK/refused"

for command in version "--version" "--help" "doctor --quick" "info /clip/scene.slod"; do
    docker run --rm --network none --read-only --tmpfs /tmp -v "$WORK/clip:/clip:ro" streamlod:ci $command \
        >"$WORK/said" 2>&1 || { cat "$WORK/said"; echo "streamlod $command failed" >&2; exit 1; }
    echo "streamlod $command: $(head -1 "$WORK/said")"
done

for profile in observe cluster gpu; do $COMPOSE -f docker/compose.yaml --profile $profile config --quiet; done
$COMPOSE $files up --detach --wait --no-build
echo "healthy"

"$PYTHON" - <<'WATCH'
import json, os, subprocess, time, urllib.request
from websockets.sync.client import connect
from tests.server.conftest import Viewer

port = os.environ["PORT"]

def stream():
    return json.load(urllib.request.urlopen(f"http://127.0.0.1:{port}/v1/streams/main", timeout=5))

def wait(done):
    limit = time.monotonic() + 30
    while not done(found := stream()):
        assert time.monotonic() < limit, found
        time.sleep(0.1)
    return found

found = wait(lambda s: s["state"] == "live")
address = f"ws://127.0.0.1:{port}" + found["live_path"]
with connect(address, subprotocols=["streamlod.v1"], compression=None, max_size=2**24, proxy=None) as connection:
    viewer = Viewer(connection).hello()
    viewer.until("caught_up")
    name = subprocess.run(["docker", "ps", "-q"], check=True, capture_output=True, text=True).stdout.strip()
    rows = subprocess.run(["docker", "top", name, "-eo", "pid,cmd"], check=True, capture_output=True, text=True).stdout
    workers = [row.split()[0] for row in rows.splitlines() if "spawn_main" in row]
    assert len(workers) == 1, rows
    subprocess.run(["kill", "-9", workers[0]], check=True)
    print("degraded:", viewer.until("state")["detail"])
    viewer.until("epoch")
    while len(set(viewer.decoder.versions)) > 1 or viewer.events[-1]["event"] == "epoch":
        viewer.step()
found = wait(lambda s: s["state"] == "live")
assert found["restarts"] == 1, found
print("live again:", {key: found[key] for key in ("state", "epoch", "restarts", "recording")})
WATCH

before=$(curl -fsS "http://127.0.0.1:$PORT/v1/streams/main/manifest" | "$PYTHON" -c "import json,sys; print(len(json.load(sys.stdin)['gops']))")
$COMPOSE $files restart --timeout 12
$COMPOSE $files up --detach --wait --no-build
after=$(curl -fsS "http://127.0.0.1:$PORT/v1/streams/main/manifest" | "$PYTHON" -c "import json,sys; print(len(json.load(sys.stdin)['gops']))")
[ "$after" -ge "$before" ] || { echo "the volume lost recordings: $before groups before, $after after" >&2; exit 1; }
echo "kept $before groups over a restart"
