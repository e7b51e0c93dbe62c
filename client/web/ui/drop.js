/** Files that are dropped onto the page, or chosen. */

/** @type {(file: File) => void} */
let take = () => {};

/** @param {(file: File) => void} play - what to do with one */
export function attachDrop(play) {
  take = play;
  const { classList } = document.body;
  /** @param {DragEvent} event */
  const over = (event) => {
    if (!event.dataTransfer?.types.includes("Files")) return;
    event.preventDefault(); // else the browser leaves the page for the file
    classList.add("dropping");
  };
  window.addEventListener("dragover", over);
  window.addEventListener("dragleave", (event) => event.relatedTarget ?? classList.remove("dropping"));
  window.addEventListener("drop", (event) => {
    classList.remove("dropping");
    const file = event.dataTransfer?.files[0];
    if (!file) return;
    event.preventDefault();
    play(file);
  });
}

/** The same by a dialog. */
export function chooseFile() {
  const field = Object.assign(document.createElement("input"), { type: "file", accept: ".slod,.json" });
  field.onchange = () => field.files?.[0] && take(field.files[0]);
  field.click();
}
