#!/usr/bin/env bash
# A Slurm cluster of one node in a folder, from Debian's packages, for this user alone:
#   tests/sweep/slurm.sh start FOLDER   downloads, starts munged, slurmctld and slurmd; prints what to export
#   tests/sweep/slurm.sh stop FOLDER    stops them
set -euo pipefail
action=$1
folder=$(mkdir -p "$2" && cd "$2" && pwd)
root="$folder/root"

stop() {
    for name in slurmd slurmctld munged; do
        [ -f "$folder/$name.pid" ] && kill "$(cat "$folder/$name.pid")" 2>/dev/null || true
    done
}

fetch() {
    [ -x "$root/usr/sbin/slurmctld-wlm" ] && return
    mkdir -p "$folder/packages" && cd "$folder/packages"
    needed=$(apt-cache depends --recurse --no-recommends --no-suggests --no-conflicts --no-breaks --no-replaces \
        --no-enhances slurmctld slurmd slurm-client munge slurm-wlm-basic-plugins |
        grep -E '^(slurm|munge|lib(munge|hwloc|ipmimonitoring|freeipmi|rdmacm|ibverbs|nl-|lz4|json-c|http-parser|yaml|jwt|jansson|pmix|event|dbus|ucx|rrd|hdf5|aec|sz2|curl3|nghttp2|ssh2|ltdl|bpf|readline|numa))' | sort -u)
    for package in $needed; do
        apt-get download "$package" >/dev/null 2>&1 || true
    done
    mkdir -p "$root"
    for package in *.deb; do dpkg-deb -x "$package" "$root"; done
}

case "$action" in
stop) stop ;;
start)
    fetch
    libraries="$root/usr/lib/x86_64-linux-gnu"
    export LD_LIBRARY_PATH="$libraries:$libraries/slurm-wlm" PATH="$root/usr/bin:$root/usr/sbin:$PATH"
    export SLURM_CONF="$folder/slurm.conf"
    chmod 0700 "$folder" && mkdir -p "$folder/state" "$folder/spool"
    [ -f "$folder/munge.key" ] || head -c 128 /dev/urandom >"$folder/munge.key"
    chmod 0400 "$folder/munge.key"
    cores=$(nproc) host=$(hostname -s)
    cat >"$SLURM_CONF" <<CONF
ClusterName=folder
SlurmctldHost=$host(127.0.0.1)
SlurmUser=$(id -un)
SlurmdUser=$(id -un)
SlurmctldPort=16817
SlurmdPort=16818
AuthType=auth/munge
AuthInfo=socket=$folder/munge.socket
CredType=cred/munge
PluginDir=$libraries/slurm-wlm
StateSaveLocation=$folder/state
SlurmdSpoolDir=$folder/spool
SlurmctldPidFile=$folder/slurmctld.pid
SlurmdPidFile=$folder/slurmd.pid
SlurmctldLogFile=$folder/slurmctld.log
SlurmdLogFile=$folder/slurmd.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SchedulerType=sched/builtin
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
AccountingStorageType=accounting_storage/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
ReturnToService=2
NodeName=$host NodeAddr=127.0.0.1 CPUs=$cores RealMemory=8000 State=UNKNOWN
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
PartitionName=main Nodes=ALL Default=YES MaxTime=INFINITE State=UP PriorityTier=1 GraceTime=60
PartitionName=urgent Nodes=ALL MaxTime=INFINITE State=UP PriorityTier=2
CONF
    stop
    sleep 1
    munged --force --key-file="$folder/munge.key" --socket="$folder/munge.socket" --pid-file="$folder/munged.pid" \
        --log-file="$folder/munged.log" --seed-file="$folder/munged.seed"
    slurmctld-wlm -c
    slurmd-wlm -c -d "$root/usr/sbin/slurmstepd-wlm"
    for _ in $(seq 60); do
        sinfo -h -o %t 2>/dev/null | grep -q idle && break
        sleep 0.5
    done
    sinfo -h -o %t | grep -q idle || { tail -5 "$folder"/*.log >&2; exit 1; }
    echo "export SLURM_CONF=$SLURM_CONF LD_LIBRARY_PATH=$LD_LIBRARY_PATH PATH=$root/usr/bin:\$PATH"
    ;;
*) echo "usage: slurm.sh start|stop FOLDER" >&2 && exit 2 ;;
esac
