/** Ways to take something along: links, a code for other pages, a picture, the recording. */

import { toText } from "../view/camera.js";
import { chooseFile } from "./drop.js";
import { attachMenu, button, element, menuItem, toast } from "./page.js";

/** @typedef {import("../view/viewer.js").Viewer} Viewer */

const REVOKE_MS = 10_000;

/**
 * @param {Viewer} viewer
 * @param {boolean} moment - with the frame that is shown, where it opens paused
 * @returns {URL}
 */
function linkTo(viewer, moment) {
  const link = new URL(location.href),
    { searchParams } = link;
  for (const name of ["token", "t", "epoch"]) searchParams.delete(name);
  searchParams.set("camera", toText(viewer.stance.pose));
  const { picture, status } = viewer;
  if (moment && picture) {
    searchParams.set("t", String(picture.version));
    if (status?.position && status.source !== "recording") searchParams.set("epoch", String(status.position.epoch));
  }
  return link;
}

/** Markup that shows this view in another page. @param {Viewer} viewer */
function embedCode(viewer) {
  const link = linkTo(viewer, false);
  link.searchParams.set("embed", "1");
  const address = link.href.replaceAll("&", "&amp;").replaceAll('"', "%22");
  return `<iframe src="${address}" width="640" height="360" style="border: 0" title="Free-viewpoint video" allow="fullscreen; xr-spatial-tracking; clipboard-write" allowfullscreen></iframe>`;
}

/** @param {string} text @param {string} said - once it is in the clipboard */
async function copy(text, said) {
  try {
    await navigator.clipboard.writeText(text);
    toast(said);
  } catch {
    const dialog = /** @type {HTMLDialogElement} */ (element("copy"));
    const field = /** @type {HTMLTextAreaElement} */ (element("copy-text"));
    field.value = text;
    dialog.showModal();
    field.select();
  }
}

/** Offer a file to the browser's downloads. @param {Blob} blob @param {string} name */
export function download(blob, name) {
  const link = Object.assign(document.createElement("a"), { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), REVOKE_MS);
}

/** @param {Viewer} viewer */
export async function savePicture(viewer) {
  download(await viewer.capture(), `streamlod-${viewer.picture?.version ?? 0}.png`);
  toast("Picture saved");
}

/** @param {Viewer} viewer */
export const copyMoment = (viewer) => copy(linkTo(viewer, true).href, "Link to this view and moment copied");

/**
 * The menu of the share button.
 * @param {import("./moments.js").Source} source
 * @param {import("./timeline.js").Timeline} timeline
 */
export function attachSharing(source, timeline) {
  const { viewer, token } = source,
    opener = button("b-share"),
    menu = element("share-menu");
  /** The frames between the mark and the one that is shown. */
  const saveClip = async () => {
    const [first, last] = [timeline.marks.newest?.version ?? 0, timeline.version].sort((a, b) => a - b);
    toast("Fetching the clip");
    const { cut } = await import("../stream/file.js");
    await cut(new URL(source.address(timeline.position?.epoch) ?? "", location.href).href, token, first, last).then(
      (blob) => download(blob, `clip-${first}-${last}.slod`),
      (error) => toast(error.message),
    );
  };
  /** @param {string} label @param {string} note @param {() => unknown} act */
  const item = (label, note, act) =>
    menuItem(label, note, null, () => {
      opener.click(); // closes
      act();
    });
  attachMenu(opener, menu, () => {
    const address = source.address(timeline.position?.epoch),
      isEmbedded = document.body.classList.contains("embed"),
      { version, position } = timeline,
      newestMark = timeline.marks.newest?.version;
    menu.replaceChildren(
      ...("share" in navigator
        ? [
            item("Share…", "", () =>
              navigator.share({ title: document.title, url: linkTo(viewer, true).href }).catch(() => {}),
            ),
          ]
        : []),
      item("Copy link to this moment", "Y", () => copyMoment(viewer)),
      item("Copy link to this view", "", () => copy(linkTo(viewer, false).href, "Link to this view copied")),
      ...(isEmbedded
        ? []
        : [item("Copy embed code", "", () => copy(embedCode(viewer), "Code for other pages copied"))]),
      item("Save picture", "P", () => savePicture(viewer)),
      item("Mark this moment", "M", () => position && timeline.marks.toggle(position)),
      item("Play a file…", ".slod", chooseFile),
      ...(address
        ? [
            ...(newestMark === undefined || newestMark === version
              ? []
              : [item("Clip since the mark", ".slod", saveClip)]),
            ...(token
              ? []
              : [
                  item("Download recording", ".slod", () =>
                    Object.assign(document.createElement("a"), { href: address, download: "" }).click(),
                  ),
                ]),
          ]
        : []),
    );
  });
}
