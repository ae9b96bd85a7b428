// Browsers start no workers from pages that are opened as files. There this class runs the script of a worker in a
// hidden frame of the page. The search of the theme finds it by the name `IFrameWorker`.
"use strict";
if (location.protocol === "file:") {
  const report = (problem) => {
    const place = document.querySelector(".md-search-result__meta");
    if (place) place.textContent = `The search does not work: ${problem}. Serve the site by HTTP, or build it again.`;
  };
  const notLoaded = (script) => `${script.src.split("/").pop()} cannot be loaded`;
  // The theme loads the index as a script.
  addEventListener("error", (event) => event.target.tagName === "SCRIPT" && report(notLoaded(event.target)), true);

  window.Worker = window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc = "<body></body>";
      this.started = new Promise((resolve) => (this.frame.onload = resolve)).then(() => this.start(url));
      this.started.catch(report);
      document.body.append(this.frame);
    }

    start(url) {
      const inner = this.frame.contentWindow;
      const load = (source) =>
        new Promise((resolve, reject) => {
          const script = inner.document.createElement("script");
          Object.assign(script, { src: source, onload: resolve, onerror: () => reject(notLoaded(script)) });
          inner.document.body.append(script);
        });
      inner.importScripts = async (...sources) => {
        for (const source of sources) await load(source);
      };
      inner.onerror = (message) => report(message);
      inner.onunhandledrejection = (event) => report(event.reason);
      inner.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      return load(new URL(url, location));
    }

    postMessage(data) {
      const receive = () => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data }));
      this.started.then(receive, () => {});
    }

    terminate() {
      this.frame.remove();
    }
  };
}
