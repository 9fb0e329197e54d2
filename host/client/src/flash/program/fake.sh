#!/bin/sh
# In place of probe-rs and dfu-util: tests link it by these names into a folder. It notes its
# arguments there, prints the list of devices of the folder, and keeps the file that it is to write.
folder=${0%/*}
name=${0##*/}
printf '%s\n' "$name" "$@" '' >>"$folder/arguments"
case $1 in
list | -l) command -p cat "$folder/$name.list" ;;
*)
    echo "$name writes"
    for file; do :; done
    if [ -f "$file" ]; then
        command -p cp "$file" "$folder/$name.written"
    fi
    ;;
esac
if [ -f "$folder/$name$1.code" ]; then
    echo "$name says why" >&2
    exit "$(command -p cat "$folder/$name$1.code")"
fi
