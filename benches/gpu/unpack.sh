# Unpacks what pack.sh packed into the folder $unpacked, and sets the paths of CUDA's libraries. Use: source unpack.sh DIR
# In the environment: UNPACKED, that folder (a new one), which is kept if it is there.
packed=$1
unpacked=${UNPACKED:-$(mktemp -d)}
if [ ! -d "$unpacked/ycb" ]; then
    mkdir -p "$unpacked/ycb"
    for file in "$packed"/*.xz; do
        case $file in
        */ycb.tar.xz) tar -C "$unpacked/ycb" -xJf "$file" & ;;
        *) xz -dc "$file" >"$unpacked/$(basename "$file" .xz)" & ;;
        esac
    done
    wait
    chmod +x "$unpacked/mambavitact" "$unpacked/gpu_bench"
fi
site=$(python3 -c 'import torch, os; print(os.path.dirname(os.path.dirname(torch.__file__)))' 2>/dev/null || true)
cuda=$(ls -d "$site"/nvidia/*/lib 2>/dev/null | tr '\n' ':')/usr/local/cuda/lib64
export YCB_DIR=$unpacked/ycb
