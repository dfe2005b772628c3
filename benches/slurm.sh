#!/usr/bin/env bash
# A sweep on Slurm: three nodes of one core each on this machine's loopback address, disturbed on purpose. Debian, as root.
#   benches/slurm.sh [TASKS=300]
# Installs slurm-wlm and munge if they are absent, starts them, and takes them down. Kills one node daemon and five tasks, cancels a job and
# queues one again; then the merged result must equal that of one process to the byte. Prints one JSON line.
# SCALING=1 measures tasks per second over 1, 2 and 3 nodes instead.
set -euo pipefail
cd "$(dirname "$0")/.."
tasks=${1:-300}
program=${MAMBAVITACT:-$PWD/target/release/mambavitact}
[ -x "$program" ] || cargo build --release
command -v slurmctld >/dev/null && command -v munged >/dev/null ||
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends slurm-wlm munge

D=$(mktemp -d)
mkdir -p "$D"/{state,log,run}
take_down() {
    local pid
    for pid in "$D"/run/*.pid; do [ -e "$pid" ] && kill "$(cat "$pid")" 2>/dev/null; done || true
    sleep 1
    rm -rf "$D"
}
trap take_down EXIT
dd if=/dev/urandom of="$D/munge.key" bs=1k count=1 2>/dev/null
chmod 400 "$D/munge.key"
cat > "$D/slurm.conf" <<CONF
ClusterName=tiny
SlurmctldHost=localhost(127.0.0.1)
SlurmUser=root
SlurmctldPort=16817
AuthType=auth/munge
AuthInfo=socket=$D/run/munge.sock
StateSaveLocation=$D/state
SlurmdSpoolDir=$D/run/spool-%n
SlurmctldPidFile=$D/run/ctld.pid
SlurmdPidFile=$D/run/slurmd-%n.pid
SlurmctldLogFile=$D/log/ctld.log
SlurmdLogFile=$D/log/slurmd-%n.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SlurmdParameters=config_overrides
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
PlugStackConfig=/dev/null
SlurmdTimeout=10
NodeName=n[1-3] NodeHostname=localhost NodeAddr=127.0.0.1 Port=[17001-17003] CPUs=1 RealMemory=900
PartitionName=main Nodes=ALL Default=YES MaxTime=600 State=UP
CONF
export SLURM_CONF="$D/slurm.conf"
munged --force --key-file="$D/munge.key" --socket="$D/run/munge.sock" --pid-file="$D/run/munged.pid" \
    --log-file="$D/log/munged.log" --seed-file="$D/run/munged.seed"
slurmctld -c
for node in n1 n2 n3; do slurmd -N $node; done
sleep 4

seeds=$((tasks / 3))
spec() {
    printf 'command = "generate"\n[fixed]\nduration = 2.0\nformat = "compact"\n[axes]\nobject = ["cube70", "large_dice", "ball"]\n'
    printf 'seed = { from = 0, count = %s }\n' "$1"
}
# Messages of finished tasks go to the logs of the jobs, where they are counted.
export MAMBAVITACT_LOG=info
json() { "$program" sweep status "$1" --json | python3 -c "import json, sys; print(json.load(sys.stdin)['$2'])"; }
wait_for() { while [ "$(json "$1" done)" -lt "$2" ]; do sleep 0.5; done; }
pending() { squeue -h | wc -l; }

if [ "${SCALING:-}" = 1 ]; then
    for nodes in 1 2 3; do
        scontrol update nodename=n[1-3] state=resume 2>/dev/null || true
        [ $nodes = 3 ] || scontrol update nodename="n[$((nodes + 1))-3]" state=drain reason=scaling
        spec "$seeds" > "$D/spec.toml"
        "$program" sweep plan "$D/spec.toml" --out "$D/scale$nodes" >/dev/null
        begun=$(date +%s.%N)
        "$program" sweep slurm "$D/scale$nodes" --shards "$nodes" --memory 800 --submit >/dev/null
        wait_for "$D/scale$nodes" "$tasks"
        python3 -c "import json, time; print(json.dumps({'nodes': $nodes, 'tasks': $tasks, 'tasks_per_s': round($tasks / (time.time() - $begun), 3)}))"
        while [ "$(pending)" -gt 0 ]; do sleep 0.5; done
    done
    exit
fi

spec "$seeds" > "$D/spec.toml"
"$program" sweep plan "$D/spec.toml" --out "$D/s" >/dev/null
begun=$(date +%s)
"$program" sweep slurm "$D/s" --shards 15 --memory 800 --submit
victims() { pgrep -f "$program sweep run $D/s " || true; }
kills=0
wait_for "$D/s" $((tasks / 10))
# One node daemon; its job goes on without it, and the node is down until the daemon comes back.
kill -KILL "$(cat "$D/run/slurmd-n2.pid")"
for step in 2 3 4 5 6; do
    wait_for "$D/s" $((tasks * step / 10))
    victim=$(victims | head -n 1)
    [ -n "$victim" ] && kill -KILL "$victim" && kills=$((kills + 1))
    case $step in
        3)
            slurmd -N n2
            sleep 1
            scontrol update nodename=n2 state=resume 2>/dev/null || true
            ;;
        4) scancel "$(squeue -h -t running -o %A | head -n 1)" ;;
        5) scontrol requeue "$(squeue -h -t running -o %A | head -n 1)" ;;
    esac
done
# What was cancelled stays undone, and is submitted again. Finished shards end at once.
for _ in 1 2 3; do
    while [ "$(pending)" -gt 0 ]; do sleep 1; done
    [ "$(json "$D/s" done)" = "$tasks" ] && break
    "$program" sweep slurm "$D/s" --submit
done
seconds=$(($(date +%s) - begun))
"$program" sweep status "$D/s" --check
twice=$(cat "$D"/s/logs/*.txt | grep -o 'task [0-9a-f]* is done' | sort | uniq -d | wc -l)
overhead=$(grep -ho '[0-9.]* ms per task' "$D"/s/logs/*.txt | sort -n | tail -n 1)
"$program" sweep merge "$D/s" --out "$D/merged" >/dev/null
"$program" sweep plan "$D/spec.toml" --out "$D/t" >/dev/null
MAMBAVITACT_LOG=warn "$program" sweep run "$D/t"
"$program" sweep merge "$D/t" --out "$D/alone" >/dev/null
diff -r "$D/alone" "$D/merged" && same=true || same=false
printf '{"tasks": %s, "done": %s, "kills": %s, "done_twice": %s, "seconds": %s, "largest_overhead": "%s", "same_bytes": %s}\n' \
    "$tasks" "$(json "$D/s" done)" "$kills" "$twice" "$seconds" "$overhead" "$same"
[ $same = true ] && [ "$twice" = 0 ] && [ "$(json "$D/s" done)" = "$tasks" ]
