#!/bin/sh
# `make demo-watch`: the daemon at work, in the folder that is given. Needs lodpipe on PATH.
set -eu
out=${1:?usage: setup/demo-watch.sh FOLDER}
cd "$(dirname "$0")/.."
rm -rf "$out"
mkdir -p "$out/drop"

say() { printf '\ndemo-watch: %s\n' "$*"; }

say "the daemon starts and watches $out/drop"
lodpipe watch "$out/drop" -c fast -o "$out/lods" --port 0 --log text 2>"$out/log.txt" &
daemon=$!
trap 'kill "$daemon" 2>/dev/null || true' EXIT INT TERM
until grep -q watching "$out/log.txt"; do
    kill -0 "$daemon" 2>/dev/null || { cat "$out/log.txt"; exit 1; }
    sleep 0.2
done

say "three models are dropped, and one that is broken"
for model in $(ls sample_assets/*.glb | head -n 3); do cp "$model" "$out/drop/"; done
head -c 2000 "$(ls sample_assets/*.glb | head -n 1)" >"$out/drop/broken.glb"
sleep 1
lodpipe status "$out/lods"

while lodpipe status "$out/lods" --json | grep -qE '"state": "(settling|waiting|queued|running)"'; do sleep 1; done
say "all are done"
lodpipe status "$out/lods"

say "it stops"
kill -TERM "$daemon"
wait "$daemon"
trap - EXIT INT TERM
tail -n 1 "$out/log.txt"
say "look into $out/lods (results, .failed for the broken one) and $out/log.txt"
