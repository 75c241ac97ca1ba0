// What the view uses of three.js.
export {
  BufferAttribute, BufferGeometry, Color, DataTexture, FloatType, LineSegments,
  Matrix4, MOUSE, Mesh, DoubleSide, OrthographicCamera, PerspectiveCamera, Points, RGBAFormat,
  Scene, ShaderMaterial, TOUCH, Vector2, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
