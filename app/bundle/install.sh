#!/bin/sh
# Makes the program known to the desktop: menu entry, icon, kinds of files, commands in PREFIX/bin.
# usage: ./install.sh [PREFIX]   default: ~/.local; the folder itself stays where it is
#        ./install.sh --remove [PREFIX]
set -eu
here=$(CDPATH= cd -- "$(dirname -- "$0")" && pwd)
remove=no
if [ "${1:-}" = --remove ]; then
  remove=yes
  shift
fi
prefix=${1:-"$HOME/.local"}
entry=$prefix/share/applications/gaga-studio.desktop
icon=$prefix/share/icons/hicolor/scalable/apps/gaga-studio.svg
types=$prefix/share/mime/packages/gaga-studio.xml

if [ "$remove" = yes ]; then
  rm -f "$entry" "$icon" "$types" "$prefix/bin/gaga-studio" "$prefix/bin/gaga"
else
  mkdir -p "${entry%/*}" "${icon%/*}" "${types%/*}" "$prefix/bin"
  sed "s|^Exec=gaga-studio|Exec=\"$here/gaga-studio\"|" "$here/desktop/gaga-studio.desktop" >"$entry"
  cp "$here/desktop/gaga-studio.svg" "$icon"
  cp "$here/desktop/gaga-studio.xml" "$types"
  ln -sf "$here/gaga-studio" "$here/gaga" "$prefix/bin/"
fi
if command -v update-desktop-database >/dev/null; then update-desktop-database "$prefix/share/applications"; fi
if command -v update-mime-database >/dev/null; then update-mime-database "$prefix/share/mime"; fi
