!> Bodies on mounts that differ in one number: 'mass', 'inertia_scale', 'center[x]', or for a mount
!! 'mounts[front].stiffness[z]' or 'mounts[front].stiffness_scale', with stiffness, damping or
!! position. Each is at its static equilibrium under its weight.
module viscovib_body_builder
  use viscovib_family_curve, only: system_builder
  use viscovib_kernel_holder, only: copy_kernels, kernel_holder
  use viscovib_kinds, only: wp
  use viscovib_mounted_body, only: build_small, mounted_body, rest_type
  use viscovib_oscillator, only: oscillator_type
  use viscovib_polynomial, only: polynomial_type
  use viscovib_status, only: clipped, fail, set_ok, show, status_input_error, status_type
  implicit none
  private

  public :: body_builder, new_body_builder

  character(len=*), parameter :: of_mounts(3) = [character(len=9) :: 'stiffness', 'damping', &
                                                 'position']
  integer, parameter :: of_mass = 4, of_inertia = 5, of_center = 6

  type, extends(system_builder) :: body_builder
    type(mounted_body) :: body
    type(kernel_holder), allocatable :: kernels(:)
    real(wp) :: center(3) = 0.0_wp
    !> The varied number: an index in `of_mounts` or one of the others; its mount and axis
    !! (0: all of them are multiplied).
    integer :: which = 0, mount = 0, axis = 0
  contains
    procedure :: build
    procedure, private :: change, change_mount
  end type body_builder

contains

  !> Create a builder for a body and the name of its varied number.
  subroutine new_body_builder(builder, body, kernels, center, name, status)
    type(body_builder), intent(out) :: builder
    type(mounted_body), intent(in) :: body
    type(kernel_holder), intent(in) :: kernels(:)
    !> Centre of mass, in the axes of the positions.
    real(wp), intent(in) :: center(3)
    character(len=*), intent(in) :: name
    type(status_type), intent(out) :: status
    integer :: at, i

    call set_ok(status)
    builder%body = body
    call copy_kernels(kernels, builder%kernels)
    builder%center = center
    select case (name)
    case ('mass')
      builder%which = of_mass
    case ('inertia_scale')
      builder%which = of_inertia
    case ('center[x]', 'center[y]', 'center[z]')
      builder%which = of_center
      builder%axis = index('xyz', name(8:8))
    case default
      at = index(name, '].')
      if (index(name, 'mounts[') == 1 .and. at > 8) then
        builder%mount = findloc(body%names == name(8:at - 1), .true., 1)
        do i = 1, size(of_mounts)
          call find_axis(name(at + 2:), trim(of_mounts(i)), builder%axis)
          if (builder%axis >= 0) builder%which = i
          if (builder%axis >= 0) exit
        end do
      end if
      if (builder%which > 0 .and. builder%mount > 0) return
      call fail(status, status_input_error, 'vary', "vary = '"//clipped(name)//"': must be nu, " &
                //'load_factor, mass, inertia_scale, center[x] or a number of a mount such as ' &
                //'mounts['//trim(body%names(1))//'].stiffness[z] or .stiffness_scale (of ' &
                //'stiffness, damping and position)')
    end select
  end subroutine new_body_builder

  !> 'stiffness[z]' is axis 3 of 'stiffness', 'stiffness_scale' axis 0; else -1.
  pure subroutine find_axis(text, key, axis)
    character(len=*), intent(in) :: text, key
    integer, intent(out) :: axis
    integer :: i
    axis = -1
    if (text == key//'_scale') axis = 0
    do i = 1, 3
      if (text == key//'['//'xyz'(i:i)//']') axis = i
    end do
  end subroutine find_axis

  subroutine build(self, p, system, status)
    class(body_builder), intent(in) :: self
    real(wp), intent(in) :: p
    class(oscillator_type), allocatable, intent(out) :: system
    type(status_type), intent(out) :: status
    type(mounted_body) :: body
    type(polynomial_type), allocatable :: made
    type(rest_type) :: rest

    body = self%body
    call self%change(p, body, status)
    if (.not. status%failed()) call body%find_rest(self%kernels, rest, status)
    allocate (made)
    if (.not. status%failed()) call build_small(body, self%kernels, rest, made, status)
    call move_alloc(made, system)
  end subroutine build

  !> Set the varied number of the body to p.
  subroutine change(self, p, body, status)
    class(body_builder), intent(in) :: self
    real(wp), intent(in) :: p
    type(mounted_body), intent(inout) :: body
    type(status_type), intent(out) :: status
    integer :: j

    call set_ok(status)
    select case (self%which)
    case (of_mass, of_inertia)
      if (.not. p > 0.0_wp) call fail(status, status_input_error, 'vary', 'vary: mass and ' &
                                      //'inertia must be greater than 0, got '//show(p))
      if (self%which == of_mass) body%mass = p
      if (self%which == of_inertia) body%inertia = p*body%inertia
    case (of_center)
      do j = 1, size(body%springs)
        body%springs(j)%arm(self%axis) = body%springs(j)%arm(self%axis) + self%center(self%axis) - p
      end do
    case default
      call self%change_mount(p, body, status)
    end select
  end subroutine change

  !> The same for one of its mounts.
  subroutine change_mount(self, p, body, status)
    class(body_builder), intent(in) :: self
    real(wp), intent(in) :: p
    type(mounted_body), intent(inout) :: body
    type(status_type), intent(out) :: status
    real(wp) :: place(3)
    integer :: j, axis

    call set_ok(status)
    if (self%which < 3 .and. .not. p >= 0.0_wp) then
      call fail(status, status_input_error, 'vary', 'vary: must not be less than 0, got '//show(p))
    end if
    do j = 1, size(body%springs)
      if (body%mount_of(j) /= self%mount) cycle
      associate (spring => body%springs(j))
        axis = body%axis_of(j)
        if (self%which == 3) then
          place = spring%arm + self%center
          if (self%axis == 0) place = p*place
          if (self%axis > 0) place(self%axis) = p
          spring%arm = place - self%center
        else if (axis > 0 .and. (self%axis == 0 .or. self%axis == axis)) then
          if (self%which == 1 .and. self%axis == 0) spring%stiffness = p*spring%stiffness
          if (self%which == 1 .and. self%axis > 0) spring%stiffness = p
          if (self%which == 2 .and. self%axis == 0) spring%damping = p*spring%damping
          if (self%which == 2 .and. self%axis > 0) spring%damping = p
        end if
      end associate
    end do
  end subroutine change_mount

end module viscovib_body_builder
