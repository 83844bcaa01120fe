! The response of a body on two rubber mounts.
! gfortran first_response.f90 $(pkg-config --cflags --libs viscovib) -o first_response
program first_response
  use viscovib_kinds, only: wp
  use viscovib_load, only: load_type, new_load
  use viscovib_mount, only: mount_parameters, mount_type, new_mount
  use viscovib_forced_response, only: forced_response
  use viscovib_oscillator, only: kernel_holder
  use viscovib_response, only: response_options, response_type
  use viscovib_response_plan, only: method_newton, new_response_plan, response_plan_type
  use viscovib_rzhanitsyn, only: new_rzhanitsyn, rzhanitsyn_kernel
  use viscovib_status, only: status_type
  implicit none
  type(rzhanitsyn_kernel) :: kernel
  type(kernel_holder) :: kernels(1)
  type(mount_parameters) :: parameters
  type(mount_type) :: mount
  type(load_type) :: load
  type(response_plan_type) :: plan
  type(response_options) :: options
  type(response_type) :: response
  type(status_type) :: status
  real(wp) :: nu(100)
  integer :: i

  call new_rzhanitsyn(kernel, 0.048_wp, 0.1_wp, 0.05_wp, status)
  if (status%failed()) error stop status%message
  allocate (kernels(1)%kernel, source=kernel)
  parameters = mount_parameters(mass=1.0_wp, inertia=0.1_wp, offset=0.5_wp, stiffness_x=10.0_wp, &
                                stiffness_phi=2.0_wp, kernel_x=1, kernel_phi=1)
  call new_mount(mount, parameters, kernels, status)
  if (status%failed()) error stop status%message
  ! 0.1 N sin(nu t) on x: one term of order 1, no base motion.
  call new_load(load, 2, [1], reshape([(0.1_wp, 0.0_wp), (0.0_wp, 0.0_wp)], [2, 1]), &
                [(0.0_wp, 0.0_wp)], status)
  nu = [(0.3_wp + 0.04_wp*i, i=1, 100)]
  options%choose_harmonics = .true.
  call new_response_plan(plan, mount, load, nu, method_newton, options, status)
  if (status%failed()) error stop status%message
  call forced_response(plan, mount, load, nu, response)
  print '(a, f0.6)', 'largest amplitude of x (m): ', maxval(abs(response%coefficients(1, 1, :)))
end program first_response
