#!/usr/bin/env bash
# Starts the image's server and runs create, upload, process and query against
# it from a second container of the same image.
#   check-container.sh [IMAGE]   default mapsieve:latest
#
# With a Docker engine the server is started by its entry point. Without one,
# CONTAINER_RUN names a command that runs "IMAGE COMMAND…" in a fresh container
# on the host's network, with the folder in RUN_VOLUME (HOST:INSIDE) mounted.
set -euo pipefail
image=${1:-mapsieve:latest}
port=${PORT:-17070}
work=$(mktemp -d)
mkdir "$work/data" "$work/client"
chmod 777 "$work" "$work/data" "$work/client"
server=

stop() {
  if [ -n "${CONTAINER_RUN:-}" ]; then
    pkill -TERM -f "mapsieved --data /data --listen 127.0.0.1:$port" || true
    wait || true
  elif [ -n "$server" ]; then
    docker stop "$server" >/dev/null
    docker rm "$server" >/dev/null
  fi
  rm -rf "$work"
}
trap stop EXIT

# What a user does, inside the client's container.
client='
set -eu
export MAPSIEVE_SERVER=127.0.0.1:$0
attempts=0
until mapsieve list >/dev/null 2>&1; do
  attempts=$((attempts + 1))
  [ $attempts -lt 120 ] || { echo "the server does not answer" >&2; exit 1; }
  sleep 1
done
cd /client
mapsieve simulate scan.las --points 200000 >/dev/null
mapsieve create campus >/dev/null
mapsieve --json upload campus scan.las >upload.json
mapsieve --json process campus --rho 0.2 >process.json
mapsieve --json query campus --max-points 5000 -o answer.ply >query.json
'

if [ -n "${CONTAINER_RUN:-}" ]; then
  RUN_VOLUME="$work/data:/data" $CONTAINER_RUN "$image" \
    mapsieved --data /data --listen "127.0.0.1:$port" >"$work/server.log" 2>&1 &
  RUN_VOLUME="$work/client:/client" $CONTAINER_RUN "$image" sh -c "$client" "$port"
else
  server=$(docker run -d -v "$work/data:/data" "$image")
  docker run --rm --network "container:$server" -v "$work/client:/client" \
    --entrypoint sh "$image" -c "$client" 7070
fi

/usr/bin/python3 - "$work/client" <<'PY'
import json
import sys

work = sys.argv[1]
upload = json.load(open(f"{work}/upload.json"))["files"][0]
process = json.load(open(f"{work}/process.json"))
query = json.load(open(f"{work}/query.json"))
assert upload["added_point_count"] == 200000, upload
assert 5000 < process["point_count"] <= 200000, process
assert query["point_count"] == 5000, query
with open(f"{work}/answer.ply", "rb") as ply:
    head = ply.read(400)
assert b"element vertex 5000" in head, head
print("container: create, upload, process and query agree")
PY
