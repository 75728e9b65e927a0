#!/bin/sh
# First boot of a machine of hpcapp: shows the host keys, and starts the guard that ends the
# machine when its lease is over or nobody uses it. It holds no secret.
LEASE_UNTIL=@LEASE_UNTIL@ IDLE_S=@IDLE_S@ PORT=@PORT@ SSH_PORT=@SSH_PORT@ MARKET=@MARKET@
LOGIN_USER=@LOGIN_USER@ CLUSTER=@CLUSTER@
ROOT=${HPCAPP_ROOT:-}
PATH=$PATH:/usr/local/sbin:/usr/sbin:/sbin
state=$ROOT/var/lib/hpcapp
mkdir -p "$state"

cat >"$state/guard" <<'GUARD'
#!/bin/sh
# Ends this machine when its lease is over or it has been idle; see limits beside this file.
ROOT=${HPCAPP_ROOT:-} every=${HPCAPP_GUARD_S:-15}
PATH=$PATH:/usr/local/sbin:/usr/sbin:/sbin
cd "$ROOT/var/lib/hpcapp" || exit 1
. ./settings
uptime_s() { cut -d. -f1 "$ROOT/proc/uptime"; }
in_use() {  # a socket that listens or is connected on the communicator's port, or a login
    cat "$ROOT/proc/net/tcp" "$ROOT/proc/net/tcp6" 2>/dev/null | awk \
        -v port="$(printf '%04X' "$PORT")" -v ssh="$(printf '%04X' "$SSH_PORT")" '
        { n = split($2, near, ":"); m = split($3, far, ":")
          if (($4 == "0A" || $4 == "01") && (near[n] == port || far[m] == port)) used = 1
          if ($4 == "01" && near[n] == ssh) used = 1 }
        END { exit !used }'
}
fetch() {  # metadata of the instance, by version 2 and else 1 of the service
    if command -v curl >/dev/null; then
        token=$(curl -sfm 2 -X PUT -H 'X-aws-ec2-metadata-token-ttl-seconds: 300' "$IMDS/api/token")
        curl -sfm 2 ${token:+-H "X-aws-ec2-metadata-token: $token"} "$IMDS/meta-data/$1"
    else
        python3 - "$IMDS" "$1" <<'PYTHON'
import sys, urllib.request as r
base, path, head = sys.argv[1], sys.argv[2], {}
try:
    ask = r.Request(base + "/api/token", method="PUT", headers={"X-aws-ec2-metadata-token-ttl-seconds": "300"})
    head = {"X-aws-ec2-metadata-token": r.urlopen(ask, timeout=2).read().decode()}
except OSError:
    pass
try:
    print(r.urlopen(r.Request(base + "/meta-data/" + path, headers=head), timeout=2).read().decode())
except OSError:
    sys.exit(1)
PYTHON
    fi
}
drain() {  # the loader says goodbye, so that its work goes to others at once
    echo "guard: this spot machine will be taken away; draining"
    folder=$ROOT/$(getent passwd "$LOGIN_USER" | cut -d: -f6)/hpcapp/$CLUSTER
    systemctl stop "hpcapp-$CLUSTER" 2>/dev/null
    read -r pid start 2>/dev/null <"$folder/loader.pid" && kill -TERM "$pid"
}
end() {
    echo "guard: $1; shutting down"
    shutdown -h now || poweroff || halt -f
}
used=$(uptime_s) drained=
while :; do
    while read -r name value; do
        case $name:$value in
        *:*[!0-9]* | *:) ;;  # half written: what was read before counts
        lease_until:*) LEASE_UNTIL=$value ;;
        idle_s:*) IDLE_S=$value ;;
        esac
    done <limits
    now=$(uptime_s)
    in_use && used=$now
    [ "$(date +%s)" -ge "$LEASE_UNTIL" ] && { end "the lease is over"; break; }
    [ $((now - used)) -ge "$IDLE_S" ] && { end "idle for $((now - used)) s"; break; }
    if [ "$MARKET" = spot ] && [ -z "$drained" ] && fetch spot/instance-action >/dev/null; then
        drained=yes
        drain
    fi
    sleep "$every"
done
GUARD
chmod 755 "$state/guard"
cat >"$state/settings" <<EOT
LEASE_UNTIL=$LEASE_UNTIL IDLE_S=$IDLE_S PORT=$PORT SSH_PORT=$SSH_PORT MARKET=$MARKET
LOGIN_USER=$LOGIN_USER CLUSTER=$CLUSTER IMDS=\${HPCAPP_IMDS:-http://169.254.169.254/latest}
EOT
[ -s "$state/limits" ] || printf 'lease_until %s\nidle_s %s\n' "$LEASE_UNTIL" "$IDLE_S" >"$state/limits"
chown "$LOGIN_USER" "$state/limits" 2>/dev/null  # so that hpcapp up can extend the lease

if [ -d "$ROOT/run/systemd/system" ]; then
    cat >"$ROOT/etc/systemd/system/hpcapp-guard.service" <<EOT
[Unit]
Description=hpcapp: ends this machine when its lease is over or it is idle
[Service]
ExecStart=/bin/sh $state/guard
Restart=always
StandardOutput=journal+console
[Install]
WantedBy=multi-user.target
EOT
    systemctl daemon-reload
    systemctl enable hpcapp-guard
    systemctl start --no-block hpcapp-guard
else
    setsid sh "$state/guard" </dev/null >"$state/guard.log" 2>&1 &
fi

n=0  # some images make their host keys a moment later
until ls "$ROOT"/etc/ssh/*.pub >/dev/null 2>&1 || [ $n = 60 ]; do n=$((n + 1)); sleep 1; done
console=$ROOT/dev/console
[ -e "$console" ] || console=/dev/null
{
    echo '-----BEGIN SSH HOST KEY KEYS-----'
    cat "$ROOT"/etc/ssh/*.pub
    echo '-----END SSH HOST KEY KEYS-----'
} >"$console" 2>/dev/null
exit 0
