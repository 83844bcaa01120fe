!> Mounts that differ in one parameter.
module viscovib_mount_builder
  use viscovib_family_curve, only: system_builder
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_mount, only: mount_parameters, mount_type, new_mount
  use viscovib_oscillator, only: oscillator_type
  use viscovib_status, only: status_type
  implicit none
  private

  public :: new_mount_builder, change_mount

  character(len=*), parameter, public :: mount_numbers(7) = &
    [character(len=13) :: 'mass', 'inertia', 'offset', 'stiffness_x', 'stiffness_phi', &
     'cubic_scale', 'memory_scale']

  type, extends(system_builder) :: mount_builder
    type(mount_parameters) :: parameters
    type(kernel_holder), allocatable :: kernels(:)
    !> Index in `mount_numbers`.
    integer :: which = 0
  contains
    procedure :: build
  end type mount_builder

contains

  !> Create a builder for a mount with a varied number `which`.
  subroutine new_mount_builder(builder, mount, which)
    class(system_builder), allocatable, intent(out) :: builder
    type(mount_type), intent(in) :: mount
    integer, intent(in) :: which
    type(mount_builder), allocatable :: made

    allocate (made)
    made%parameters = mount%parameters
    call copy_kernels(mount%kernels, made%kernels)
    made%which = which
    call move_alloc(made, builder)
  end subroutine new_mount_builder

  subroutine build(self, p, system, status)
    class(mount_builder), intent(in) :: self
    real(wp), intent(in) :: p
    class(oscillator_type), allocatable, intent(out) :: system
    type(status_type), intent(out) :: status
    type(mount_type), allocatable :: mount
    type(mount_parameters) :: parameters

    parameters = self%parameters
    call set_number(parameters, self%which, p)
    allocate (mount)
    call new_mount(mount, parameters, self%kernels, status)
    call move_alloc(mount, system)
  end subroutine build

  !> Set number `which` of a mount to p.
  subroutine change_mount(mount, which, p, status)
    type(mount_type), intent(inout) :: mount
    integer, intent(in) :: which
    real(wp), intent(in) :: p
    type(status_type), intent(out) :: status
    type(mount_parameters) :: parameters
    type(kernel_holder), allocatable :: kernels(:)

    parameters = mount%parameters
    call copy_kernels(mount%kernels, kernels)
    call set_number(parameters, which, p)
    call new_mount(mount, parameters, kernels, status)
  end subroutine change_mount

  pure subroutine set_number(parameters, which, p)
    type(mount_parameters), intent(inout) :: parameters
    integer, intent(in) :: which
    real(wp), intent(in) :: p
    select case (which)
    case (1)
      parameters%mass = p
    case (2)
      parameters%inertia = p
    case (3)
      parameters%offset = p
    case (4)
      parameters%stiffness_x = p
    case (5)
      parameters%stiffness_phi = p
    case (6)
      parameters%cubic_scale = p
    case default
      parameters%memory_scale = p
    end select
  end subroutine set_number

end module viscovib_mount_builder
