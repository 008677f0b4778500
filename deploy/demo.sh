#!/usr/bin/env bash
# Shows mapsieve at work: simulates a campus scan, serves it, compresses it,
# queries it and draws what comes out, into build/demo.
#   demo.sh [POINTS]   points of the scan, default 4650000
set -euo pipefail
cd "$(dirname "$0")/.."
points=${1:-4650000}

./deploy/install-deps.sh
launcher=()
command -v ccache >/dev/null && launcher=(-DCMAKE_CXX_COMPILER_LAUNCHER=ccache)
echo "== building"
cmake --preset release "${launcher[@]}" >/dev/null
cmake --build --preset release -j "$(nproc)" --target mapsieve mapsieved

bin=$PWD/build/release/bin
out=build/demo
rm -rf "$out"
mkdir -p "$out"
cd "$out"
export PATH=$bin:$PATH

echo "== simulating $points points"
mapsieve --json simulate campus.las --points "$points" --seed 1 >simulate.json

echo "== serving"
mapsieved --data data --listen 127.0.0.1:0 --memory 2GiB >listening.txt 2>server.log &
server=$!
trap 'kill "$server" 2>/dev/null || true; wait "$server" 2>/dev/null || true' EXIT
for _ in $(seq 300); do
  [ -s listening.txt ] && break
  kill -0 "$server" 2>/dev/null || { cat server.log >&2; exit 1; }
  sleep 0.1
done
MAPSIEVE_SERVER=$(sed -n 's/^mapsieved listening on //p' listening.txt)
export MAPSIEVE_SERVER

mapsieve create campus >/dev/null
mapsieve --json upload campus campus.las >upload.json
mapsieve --json process campus --rho 0.2 --sigma 0.2 >process.json
mapsieve --json info campus >info.json

echo "== querying"
center=$(/usr/bin/python3 - <<'PY'
import json
bounds = json.load(open("info.json"))["bounds"]
print(*((a + b) / 2 for a, b in zip(bounds["min"], bounds["max"])))
PY
)
# shellcheck disable=SC2086
mapsieve --json query campus --sphere $center 60 --labels curve,junction -o around.ply >around.json
mapsieve --json query campus --max-points 30000 -o campus_30000.ply >budget.json
mapsieve --json query campus -o campus.ply >whole.json
mapsieve --json sample campus.las --method random --max-points 30000 -o random_30000.ply >random.json

peak=$(awk '/VmHWM/ {printf "%.0f MiB", $2 / 1024}' "/proc/$server/status")
kill -TERM "$server"
wait "$server"
trap - EXIT

echo "== drawing"
mapsieve render "before=campus.las" "after=campus.ply" -o before_after.png --width 2400 >/dev/null
mapsieve render "random=random_30000.ply" "SpDF=campus_30000.ply" \
  -o random_spdf.png --width 2400 >/dev/null
mapsieve render campus_30000.ply -o campus_30000.png --view oblique >/dev/null
mapsieve render "curves and junctions within 60 m=around.ply" -o around.png --view oblique >/dev/null

/usr/bin/python3 - "$peak" <<'PY'
import json
import os
import sys

def load(name):
    return json.load(open(name))

def row(name, value):
    print(f"{name:<34}{value}")

simulate, upload, process = load("simulate.json"), load("upload.json"), load("process.json")
info, around, budget, whole = load("info.json"), load("around.json"), load("budget.json"), load("whole.json")
file = upload["files"][0]
labels = info["label_counts"]
print()
row("points scanned", simulate["point_count"])
row("points after the filter", info["point_count"])
row("  surface, curve, junction", f'{labels["surface"]}, {labels["curve"]}, {labels["junction"]}')
row("  outliers rejected", info["outlier_count"])
row("LAS file", f'{os.path.getsize("campus.las") / 1e6:.1f} MB')
row("stored, raw points and result", f'{info["stored_bytes"] / 1e6:.1f} MB')
row("whole map as PLY", f'{os.path.getsize("campus.ply") / 1e6:.1f} MB, {whole["point_count"]} points')
row("curves and junctions within 60 m", f'{around["point_count"]} points')
row("whole map under a budget", f'{budget["point_count"]} points, {os.path.getsize("campus_30000.ply") / 1e6:.1f} MB')
row("simulate", f'{simulate["simulate_s"]:.1f} s')
row("upload", f'{file["upload_s"]:.1f} s')
row("process", f'{process["process_s"]:.1f} s, {process["round_count"]} rounds')
row("query around, budget, whole", f'{around["query_s"]:.1f} s, {budget["query_s"]:.1f} s, {whole["query_s"]:.1f} s')
row("server's peak memory", sys.argv[1])
PY
echo
echo "pictures and points: $out/{before_after,random_spdf,campus_30000,around}.png, $out/*.ply"
