export {
  BufferAttribute, BufferGeometry, Color, DataTexture, DynamicDrawUsage, FloatType,
  InstancedBufferAttribute, InstancedBufferGeometry, MOUSE, Matrix4, Mesh, NearestFilter,
  OrthographicCamera, PerspectiveCamera, Points, RGBAFormat, Scene, ShaderMaterial, Sphere,
  TOUCH, UnsignedByteType, Vector2, Vector3, Vector4, WebGLRenderer,
} from 'three';
export { OrbitControls } from 'three/addons/controls/OrbitControls.js';
