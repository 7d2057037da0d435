// "Lights off": always there, and independent of every other part of the page.
import { ask } from "/server.js";

const button = document.getElementById("lights-off"), said = document.getElementById("lights-said");

async function lightsOff() {
  said.textContent = "";
  try {
    await ask("/light/off", { json: {} });
    said.textContent = "all channels are off";
    setTimeout(() => { said.textContent = ""; }, 4000);
  } catch (error) {
    said.textContent = `Lights off failed: ${error.message}. Cut the power of the light box.`;
  }
}
button.addEventListener("click", lightsOff);
document.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() === "o" && !event.ctrlKey && !event.metaKey && !event.altKey && !event.target.closest?.("input, dialog")) lightsOff();
});
