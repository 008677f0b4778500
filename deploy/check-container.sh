#!/usr/bin/env bash
# Starts the image and runs create, upload, process and query against it.
#   check-container.sh [IMAGE]   default mapsieve:latest
#
# With a Docker engine the image is run by it. Without one, CONTAINER_RUN names
# a command that runs "IMAGE COMMAND…" in a fresh container on the host's
# network, with the folder in RUN_VOLUME (HOST:INSIDE) mounted.
set -euo pipefail
image=${1:-mapsieve:latest}
port=${PORT:-17070}
work=$(mktemp -d)
chmod 777 "$work"
server=

stop() {
  if [ -n "${CONTAINER_RUN:-}" ]; then
    [ -z "$server" ] || kill "$server" 2>/dev/null || true
    pkill -TERM -f "mapsieved --data /data --listen 127.0.0.1:$port" 2>/dev/null || true
    [ -z "$server" ] || wait "$server" 2>/dev/null || true
  else
    [ -z "$server" ] || docker rm -f "$server" >/dev/null
  fi
  rm -rf "$work"
}
trap stop EXIT

if [ -n "${CONTAINER_RUN:-}" ]; then
  run() { RUN_VOLUME="$work:/data" $CONTAINER_RUN "$image" "$@"; }
  run mapsieved --data /data --listen "127.0.0.1:$port" >"$work/server.log" 2>&1 &
  server=$!
else
  server=$(docker run -d --network host -v "$work:/data" --entrypoint mapsieved "$image" \
    --data /data --listen "127.0.0.1:$port")
  run() { docker exec "$server" "$@"; }
fi
client() { run mapsieve --server "127.0.0.1:$port" --json "$@"; }

for attempt in $(seq 60); do
  client list >/dev/null 2>&1 && break
  [ "$attempt" -lt 60 ] || { echo "the server does not answer" >&2; cat "$work/server.log" >&2; exit 1; }
done

client simulate /data/scan.las --points 200000 >/dev/null
client create campus >/dev/null
client upload campus /data/scan.las >"$work/upload.json"
client process campus --rho 0.2 >"$work/process.json"
client query campus --max-points 5000 -o /data/answer.ply >"$work/query.json"

/usr/bin/python3 - "$work" <<'PY'
import json
import sys

work = sys.argv[1]
upload = json.load(open(f"{work}/upload.json"))["files"][0]
process = json.load(open(f"{work}/process.json"))
query = json.load(open(f"{work}/query.json"))
assert upload["added_point_count"] == 200000, upload
assert 0 < process["point_count"] <= 200000, process
assert query["point_count"] == min(5000, process["point_count"]), query
with open(f"{work}/answer.ply", "rb") as ply:
    head = ply.read(400)
assert b"element vertex 5000" in head, head
print("container: create, upload, process and query agree")
PY
