// "Lights off": always there, and independent of every other part of the page.
import { ask } from "/server.js";

const button = document.getElementById("lights-off"), lightsStatus = document.getElementById("lights-status");

async function lightsOff() {
  lightsStatus.textContent = "";
  try {
    await ask("/light/off", { json: {} });
    lightsStatus.textContent = "all channels are off";
    setTimeout(() => { lightsStatus.textContent = ""; }, 4000);
  } catch (error) {
    lightsStatus.textContent = `Lights off failed: ${error.message}. Cut the power of the light box.`;
  }
}
button.addEventListener("click", lightsOff);
document.addEventListener("keydown", (event) => {
  if (event.key.toLowerCase() === "o" && !event.ctrlKey && !event.metaKey && !event.altKey && !event.target.closest?.("input, dialog")) lightsOff();
});
