!> The &mount group of a scene.
module viscovib_mount_groups
  use viscovib_group_reader, only: group_reader
  use viscovib_kernel_holder, only: kernel_holder
  use viscovib_mount, only: mount_parameters, mount_type, new_mount
  use viscovib_status, only: status_type
  implicit none
  private

  public :: read_mount

contains

  subroutine read_mount(reader, kernels, parameters, mount)
    type(group_reader), intent(inout) :: reader
    type(kernel_holder), intent(in) :: kernels(2)
    !> Knows which kernel acts on which spring already.
    type(mount_parameters), intent(inout) :: parameters
    type(mount_type), intent(out) :: mount
    type(status_type) :: status
    character(len=:), allocatable :: word

    parameters%mass = reader%read_real('mass')
    parameters%inertia = reader%read_real('inertia')
    parameters%offset = reader%read_real('offset')
    parameters%stiffness_x = reader%read_real('stiffness_x')
    parameters%stiffness_phi = reader%read_real('stiffness_phi')
    word = reader%read_text('geometry', choice=parameters%geometry)
    parameters%cubic_scale = reader%read_real('cubic_scale')
    parameters%memory_scale = reader%read_real('memory_scale')
    ! Row by row in the file, as one writes a matrix.
    parameters%damping = reshape(reader%read_reals('damping'), [2, 2], order=[2, 1])
    if (reader%status%failed()) return
    call new_mount(mount, parameters, kernels(:max(parameters%kernel_x, parameters%kernel_phi)), &
                   status)
    call reader%place(status)
  end subroutine read_mount

end module viscovib_mount_groups
